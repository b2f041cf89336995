/* Control code in C as a controller of tick.h: the step of a firmware.h. C99. */
#ifndef FIRMWARE_CONTROLLER_H
#define FIRMWARE_CONTROLLER_H

#include "firmware.h"
#include "tick.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct firmware_controller {
  uint32_t size;
  int32_t reserved;
  void (*step)(void* with, const firmware_input* in, firmware_output* out);
  void* with;
  /* Rows of joint targets, an entry per joint each, and the tick from which on each one holds, in
   * ascending order. They are given as new in every period. */
  const int64_t* row_tick;
  const double* rows;
  int64_t row_count;
  int64_t row; /* that holds; -1 at first, and without rows */
  arm_command* command;
  arm_joint_command* joint; /* of the command */
  double* further;          /* of the command */
  int64_t tick;             /* of the newest step */
  const int32_t* stop;      /* null, or not 0 after a step that ends the run before its period */
} firmware_controller;

/* Progress of a run with a library, for an observer in another process. */
typedef struct firmware_progress {
  int32_t doing; /* the code that runs, and its function */
  firmware_controller controller;
} firmware_progress;

/* `answer` of a tick_controller; `with` is a firmware_controller. */
const arm_command* firmware_controller_answer(void* with, const tick_machine* at);

/* The step of a library, `with` being what its arm_firmware() returned. */
void firmware_controller_step(void* with, const firmware_input* in, firmware_output* out);

#ifdef __cplusplus
}
#endif

#endif
