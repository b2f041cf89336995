/* Our servo on an arm that MuJoCo steps, for loops_beside_mujoco.py. C99. */
#ifndef MUJOCO_LOOP_H
#define MUJOCO_LOOP_H

#include "servo.h"

/* An arm of MuJoCo: its own step, model and data, and where these have what a loop needs. */
typedef struct mujoco_arm {
  uint32_t size;
  int32_t joints;
  void (*step)(void* model, void* data); /* mj_step */
  void* model;
  void* data;
  const double* angle;   /* of the joints' motors, one after the other [rad] */
  const double* current; /* [A] */
  const double* q;       /* of the links [rad] */
  double* command;       /* [V] */
} mujoco_arm;

/* Rows of targets (periods, joints) are followed, with so many steps under each; the links' angles
 * after them go to `way`. */
void run_mujoco(const mujoco_arm* arm, const servo_joint* joint, servo_state* state,
                const double* q_target, const double* v_target, int64_t periods, int64_t steps,
                double* way);

#endif
