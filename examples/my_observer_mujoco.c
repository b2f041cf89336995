/* The same in MuJoCo: it has no loop for control code, so that the program is one, with the
 * encoders. */
#include <math.h>
#include <mujoco/mujoco.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

enum { JOINTS = 3, ROWS = 100 };
static const double PERIOD = 1e-3, COUNT = 6.283185307179586 / 1024.0, RATIO = 0.01; /* s, rad */
static const double J = 1e-4, Kt = 0.05, R = 1.0;         /* kg m2, N m/A, ohm */
static const double POLE = 150.0, Kp = 20.0, Kv = 60.0;   /* rad/s, 1/s, 1/s */
static double angle[JOINTS], speed[JOINTS], load[JOINTS]; /* rad, rad/s, N m; of the motors */
static int known;

static void observe(int j, double measured, double current) {
  if (!known) angle[j] = measured, speed[j] = load[j] = 0.0;
  const double rate = (Kt * current - load[j]) / J, w = PERIOD * POLE;
  const double off = measured - angle[j] - PERIOD * (speed[j] + 0.5 * PERIOD * rate);
  angle[j] = measured - (1.0 - 3.0 * w) * off; /* three poles at POLE */
  speed[j] += PERIOD * rate + 3.0 * w * POLE * off;
  load[j] -= w * POLE * POLE * J * off;
}

static void step(const mjModel* model, mjData* data, const double* q_target) {
  for (int j = 0; j < JOINTS; ++j) {
    observe(j, COUNT * (floor(data->qpos[j] / COUNT) + 0.5), data->act[model->actuator_actadr[j]]);
    const double wanted = Kp * (q_target[j] / RATIO - angle[j]);
    data->ctrl[j] = R / Kt * (J * Kv * (wanted - speed[j]) + load[j]) + Kt * speed[j];
    data->ctrl[j] = fmax(-48.0, fmin(48.0, data->ctrl[j]));
  }
  known = 1;
}

int main(int count, char** words) { /* MODEL TABLE SECONDS TIMESTEP */
  static double table[ROWS][JOINTS + 1];
  int rows = 0, row = 0;
  char message[1000] = "", line[1000];
  FILE* file = count == 5 ? fopen(words[2], "r") : NULL;
  mjModel* model = count == 5 ? mj_loadXML(words[1], NULL, message, sizeof message) : NULL;
  if (!file || !model) return fprintf(stderr, "no model or table: %s\n", message), 2;
  for (int k = 0; fgets(line, sizeof line, file) && rows < ROWS; ++k)
    if (k > 0 && sscanf(line, "%lf,%lf,%lf,%lf", &table[rows][0], &table[rows][1], &table[rows][2],
                        &table[rows][3]) == 4)
      ++rows;
  model->opt.timestep = atof(words[4]);
  mjData* data = mj_makeData(model);
  const double q[JOINTS] = {0.0, 0.5, 0.8};
  for (int j = 0; j < JOINTS; ++j) data->qpos[j] = q[j] / RATIO, data->qpos[JOINTS + j] = q[j];
  const int ticks = (int)lround(atof(words[3]) / PERIOD);
  const int steps = (int)lround(PERIOD / model->opt.timestep);
  struct timespec begin, end;
  clock_gettime(CLOCK_MONOTONIC, &begin);
  for (int tick = 0; tick < ticks; ++tick) {
    while (row + 1 < rows && table[row + 1][0] <= tick * PERIOD + 1e-9) ++row;
    step(model, data, table[row] + 1);
    for (int k = 0; k < steps; ++k) mj_step(model, data);
  }
  clock_gettime(CLOCK_MONOTONIC, &end);
  const double wall =
      (double)(end.tv_sec - begin.tv_sec) + 1e-9 * (double)(end.tv_nsec - begin.tv_nsec);
  printf("real-time factor %.1f\nq %.9f %.9f %.9f\n", ticks * PERIOD / wall, data->qpos[JOINTS],
         data->qpos[JOINTS + 1], data->qpos[JOINTS + 2]);
  mj_deleteData(data), mj_deleteModel(model), fclose(file);
  return 0;
}
