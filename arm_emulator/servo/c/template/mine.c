/* Control code of your own. This is our servo, ready to be changed: what you write takes the place
 * of the three calls in `step`. servo_joints.h has its numbers; the Makefile writes it. */
#include <string.h>

#include "firmware.h"
#include "servo.h"
#include "servo_joints.h"

static servo_state states[SERVO_JOINTS];
static servo arm = {.joints = SERVO_JOINTS,
                    .joint = servo_joints,
                    .state = states,
                    .watchdog = {.hold_after = SERVO_HOLD_AFTER, .cut_after = SERVO_CUT_AFTER},
                    .motion_period = SERVO_MOTION_PERIOD};

static const char* start(const firmware_machine* machine) {
  if (machine->joints != SERVO_JOINTS || machine->period != SERVO_PERIOD)
    return "made for scene " SERVO_SCENE ", another one";
  for (int j = 0; j < SERVO_JOINTS; ++j)
    if (strcmp(machine->joint[j].name, servo_names[j])) return "made for other joints";
  servo_reset(&arm);
  return NULL;
}

static void step(const firmware_input* in, firmware_output* out) {
  int64_t counts[SERVO_JOINTS], closed[SERVO_JOINTS];
  servo_real current[SERVO_JOINTS], applied[SERVO_JOINTS], q[SERVO_JOINTS], command[SERVO_JOINTS];
  for (int j = 0; j < SERVO_JOINTS; ++j) {
    counts[j] = in->measured->joint[j].encoder;
    closed[j] = in->measured->joint[j].brake;
    current[j] = (servo_real)in->measured->joint[j].current;
    applied[j] = (servo_real)in->measured->joint[j].applied;
    q[j] = (servo_real)in->q_target[j];
  }
  servo_measure(&arm, in->time, counts, current, applied, closed);
  if (in->new_targets) servo_aim(&arm, q, NULL, NULL);
  servo_command(&arm, (int32_t)in->measured->powered, command);
  for (int j = 0; j < SERVO_JOINTS; ++j) out->joint[j].value = (double)command[j];
}

const firmware* arm_firmware(void) {
  static const firmware mine = {FIRMWARE_VERSION, 0, start, step};
  return &mine;
}
