/* Our servo in the loop with a machine. */
#include "servo_step.h"

#include <stddef.h>

static void take(servo_step* step, int64_t now, const arm_measurement* measured) {
  for (int32_t j = 0; j < step->arm->joints; ++j) {
    const arm_joint_measurement* joint = &measured->joint[step->place[j]];
    step->counts[j] = joint->encoder;
    step->closed[j] = joint->brake;
    step->current[j] = joint->current;
    step->applied[j] = joint->applied;
  }
  servo_measure(step->arm, now, step->counts, step->current, step->applied, step->closed);
}

void servo_step_measure(servo_step* step, tick_machine* at) {
  tick_measure(at);
  take(step, at->tick * at->period, at->measurement);
  step->measured = 1;
}

void servo_step_step(void* with, const firmware_input* in, firmware_output* out) {
  servo_step* step = with;
  const int32_t joints = step->arm->joints;
  if (!step->measured) take(step, in->time, in->measured);
  step->measured = 0;
  if (in->new_targets) {
    for (int32_t j = 0; j < joints; ++j) step->q[j] = in->q_target[step->place[j]];
    servo_aim(step->arm, step->q, NULL, NULL);
  }
  servo_command(step->arm, (int32_t)in->measured->powered, step->command);
  for (int32_t j = 0; j < joints; ++j) out->joint[step->place[j]].value = step->command[j];
}
