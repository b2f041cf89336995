/* Our servo in the loop with a machine. */
#include "servo_step.h"

#include <stddef.h>

static void take(servo_step* one, int64_t now, const arm_measurement* measured) {
  for (int32_t j = 0; j < one->arm->joints; ++j) {
    const arm_joint_measurement* joint = &measured->joint[one->place[j]];
    one->counts[j] = joint->encoder;
    one->closed[j] = joint->brake;
    one->current[j] = joint->current;
    one->applied[j] = joint->applied;
  }
  servo_measure(one->arm, now, one->counts, one->current, one->applied, one->closed);
}

void servo_step_measure(servo_step* one, tick_machine* at) {
  tick_measure(at);
  take(one, at->tick * at->period, at->measurement);
  one->measured = 1;
}

void servo_step_step(void* with, const firmware_input* in, firmware_output* out) {
  servo_step* one = with;
  const int32_t joints = one->arm->joints;
  if (!one->measured) take(one, in->time, in->measured);
  one->measured = 0;
  if (in->new_targets) {
    for (int32_t j = 0; j < joints; ++j) one->q[j] = in->q_target[one->place[j]];
    servo_aim(one->arm, one->q, NULL, NULL);
  }
  servo_command(one->arm, (int32_t)in->measured->powered, one->command);
  for (int32_t j = 0; j < joints; ++j) out->joint[one->place[j]].value = one->command[j];
}
