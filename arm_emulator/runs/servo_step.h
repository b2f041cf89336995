/* Our servo in the loop with a machine: a step of firmware_controller.h. C99. */
#ifndef SERVO_STEP_H
#define SERVO_STEP_H

#include "firmware_controller.h"
#include "servo.h"

typedef struct servo_step {
  servo* arm;
  const int32_t* place;     /* of each of its joints among the machine's */
  int64_t *counts, *closed; /* what is handed to it, an entry per joint */
  double *current, *applied, *q, *command;
  int32_t measured; /* 1: it has taken the measurement of this period already */
  int32_t reserved;
} servo_step;

/* Take the measurement of the coming period before its step, for whoever sets a target by it. */
void servo_step_measure(servo_step* step, tick_machine* at);
/* firmware_controller's step; `with` is a servo_step. */
void servo_step_step(void* with, const firmware_input* in, firmware_output* out);

#endif
