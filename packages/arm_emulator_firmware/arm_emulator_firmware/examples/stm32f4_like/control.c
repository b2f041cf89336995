#include "control.h"

#include <stddef.h>

#include "converters.h"
#include "servo_joints.h"

static servo_state states[SERVO_JOINTS];
static servo arm = {.joints = SERVO_JOINTS,
                    .joint = servo_joints,
                    .state = states,
                    .watchdog = {.hold_after = SERVO_HOLD_AFTER, .cut_after = SERVO_CUT_AFTER},
                    .motion_period = SERVO_MOTION_PERIOD};
static int64_t now;
static servo_real applied[SERVO_JOINTS];

void control_start(void) {
  servo_reset(&arm);
  now = 0;
  for (int j = 0; j < SERVO_JOINTS; ++j) applied[j] = 0;
}

void control_step(const int64_t* encoder, const uint32_t* adc, const float* q, int powered,
                  uint32_t* compare) {
  servo_real current[SERVO_JOINTS], target[SERVO_JOINTS], voltage[SERVO_JOINTS];
  for (int j = 0; j < SERVO_JOINTS; ++j) current[j] = amperes(j, adc[j]);
  servo_measure(&arm, now, encoder, current, applied, NULL);
  if (q) {
    for (int j = 0; j < SERVO_JOINTS; ++j) target[j] = q[j];
    servo_aim(&arm, target, NULL, NULL);
  }
  servo_command(&arm, powered, voltage);
  for (int j = 0; j < SERVO_JOINTS; ++j) {
    compare[j] = compare_of(voltage[j]);
    applied[j] = command_of(compare[j]);
  }
  now += SERVO_PERIOD;
}
