/* A servo with an observer for the three-axis arm: speed of each motor and the load on it, from
 * encoder and current; a cascade over both. docs/how_to/programs.md shows how to run it. */
#include "firmware.h"

enum { JOINTS = 3 };
static const double PERIOD = 1e-3, COUNT = 6.283185307179586 / 1024.0, RATIO = 0.01; /* s, rad */
static const double J = 1e-4, Kt = 0.05, R = 1.0;         /* kg m2, N m/A, ohm */
static const double POLE = 150.0, Kp = 20.0, Kv = 60.0;   /* rad/s, 1/s, 1/s */
static double angle[JOINTS], speed[JOINTS], load[JOINTS]; /* rad, rad/s, N m; of the motors */
static int known;

static const char* start(const firmware_machine* machine) {
  known = 0;
  return machine->joints == JOINTS && machine->period == 1000000 ? 0 : "made for three_axis";
}

static void observe(int j, double measured, double current) {
  if (!known) angle[j] = measured, speed[j] = load[j] = 0.0;
  const double rate = (Kt * current - load[j]) / J, w = PERIOD * POLE;
  const double off = measured - angle[j] - PERIOD * (speed[j] + 0.5 * PERIOD * rate);
  angle[j] = measured - (1.0 - 3.0 * w) * off; /* three poles at POLE */
  speed[j] += PERIOD * rate + 3.0 * w * POLE * off;
  load[j] -= w * POLE * POLE * J * off;
}

static void step(const firmware_input* in, firmware_output* out) {
  for (int j = 0; j < JOINTS; ++j) {
    const arm_joint_measurement* at = &in->measured->joint[j];
    observe(j, COUNT * ((double)at->encoder + 0.5), at->current);
    const double wanted = Kp * (in->q_target[j] / RATIO - angle[j]);
    out->joint[j].value = R / Kt * (J * Kv * (wanted - speed[j]) + load[j]) + Kt * speed[j];
  }
  known = 1;
}

const firmware* arm_firmware(void) {
  static const firmware mine = {FIRMWARE_VERSION, 0, start, step};
  return &mine;
}
