#include "mujoco_loop.h"

#include <math.h>

void run_mujoco(const mujoco_arm* arm, const servo_joint* joint, servo_state* state,
                const double* q_target, const double* v_target, int64_t periods, int64_t steps,
                double* way) {
  const int32_t joints = arm->joints;
  for (int64_t period = 0; period < periods; ++period) {
    for (int32_t j = 0; j < joints; ++j) {
      const int64_t at = period * joints + j;
      const int64_t counts = (int64_t)floor(arm->angle[j] / joint[j].count_angle);
      servo_joint_observe(joint + j, state + j, counts, arm->current[j], arm->command[j]);
      arm->command[j] = servo_joint_control(joint + j, state + j, q_target[at], v_target[at], 0.0);
    }
    for (int64_t k = 0; k < steps; ++k) arm->step(arm->model, arm->data);
    for (int32_t j = 0; j < joints; ++j) way[period * joints + j] = arm->q[j];
  }
}
