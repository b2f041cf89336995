/* Our servo in the loop with the arms of a fleet. */
#include "servo_fleet.h"

#include <stddef.h>

static void measure(const servo_fleet* fleet, servo* arm, int64_t now,
                    const arm_joint_measurement* joint) {
  int64_t counts[fleet->joints];
  double current[fleet->joints], applied[fleet->joints];
  for (int32_t j = 0; j < fleet->joints; ++j) {
    const arm_joint_measurement* one = &joint[fleet->place[j]];
    counts[j] = one->encoder;
    current[j] = one->current;
    applied[j] = one->applied;
  }
  servo_measure(arm, now, counts, current, applied);
}

static void aim(const servo_fleet* fleet, servo* arm, int32_t k, int64_t tick) {
  if (!fleet->rows || tick % fleet->periods_per_row) return;
  int64_t row = tick / fleet->periods_per_row;
  if (row >= fleet->rows) row = fleet->rows - 1;
  const int64_t at = row * fleet->row_stride + k * fleet->arm_stride;
  const int last = tick / fleet->periods_per_row >= fleet->rows; /* it stands there */
  servo_aim(arm, fleet->q + at, fleet->v && !last ? fleet->v + at : NULL,
            fleet->tau ? fleet->tau + at : NULL);
}

void servo_fleet_reset(servo_fleet* fleet, int32_t arms, const uint8_t* mask) {
  for (int32_t k = 0; k < arms; ++k)
    if (mask[k]) {
      servo_reset(&fleet->arm[k]);
      fleet->tick[k] = 0;
    }
}

void servo_fleet_step(void* with, int32_t first, int32_t arms, const arm_joint_measurement* joint,
                      const uint8_t* powered, arm_joint_command* command) {
  const servo_fleet* fleet = with;
  for (int32_t k = first; k < first + arms; ++k) {
    servo* arm = &fleet->arm[k];
    const int64_t tick = fleet->tick[k]++, from = (int64_t)k * fleet->joints;
    double value[fleet->joints];
    measure(fleet, arm, tick * fleet->period, joint + from);
    aim(fleet, arm, k, tick);
    servo_command(arm, powered[k], value);
    for (int32_t j = 0; j < fleet->joints; ++j) command[from + fleet->place[j]].value = value[j];
  }
}
