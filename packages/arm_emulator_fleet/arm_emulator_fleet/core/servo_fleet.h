/* Our servo in the loop with the arms of a fleet, several side by side in the lanes of vectors:
 * control code of arm_fleet.h. */
#ifndef SERVO_FLEET_H
#define SERVO_FLEET_H

#include "arm_fleet.h"
#include "servo.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct servo_fleet {
  uint32_t size;
  int32_t joints;
  servo* arm;           /* one of each arm, for its numbers; what changes is in lanes */
  const int32_t* place; /* of each of a servo's joints among the machine's */
  int64_t period;       /* ns */
  /* Rows of targets, in the servo's order of joints: `row_stride` numbers from one to the next, and
   * `arm_stride` from an arm to the next. The last row stays. `v` and `tau` may be null. */
  int64_t rows, periods_per_row, row_stride, arm_stride;
  const double *q, *v, *tau;
  /* Or rows of each arm for itself, each given in every period from a tick on: those of arm k are
   * [first_row[k], first_row[k + 1]), `since` has their ticks, ascending from 0. `row` is the one
   * that holds. Null: the rows above. */
  const int64_t *since, *first_row;
  int64_t* row;
  struct servo_lanes* lanes; /* of `servo_fleet_begin` */
} servo_fleet;

/* Take over the numbers of the joints of so many arms, and forget everything. */
void servo_fleet_begin(servo_fleet* fleet, int32_t arms);
void servo_fleet_end(servo_fleet* fleet);
/* Have the servos of a mask with a byte for each arm forget everything; targets begin anew. */
void servo_fleet_reset(servo_fleet* fleet, int32_t arms, const uint8_t* mask);
/* The arms' motion periods or their rows of targets have changed. */
void servo_fleet_aim(servo_fleet* fleet, int32_t arms);
/* Change the numbers of the joints of an arm. */
void servo_fleet_retune(servo_fleet* fleet, int32_t arm, const servo_joint* joint);
/* A period of some arms; `with` is a servo_fleet. */
void servo_fleet_step(void* with, const arm_fleet_rows* rows);

#ifdef __cplusplus
}
#endif

#endif
