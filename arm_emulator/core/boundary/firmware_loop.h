/* A machine behind arm.h and control code in C, servo period by servo period. C99. */
#ifndef FIRMWARE_LOOP_H
#define FIRMWARE_LOOP_H

#include "firmware.h"

#ifdef __cplusplus
extern "C" {
#endif

/* The machine, the functions of its library, and the control code. */
typedef struct firmware_loop {
  uint32_t size;
  int32_t joints;
  arm_machine* machine;
  int (*measure)(const arm_machine*, arm_measurement*);
  int (*exchange)(arm_machine*, const arm_command*, arm_measurement*);
  void (*step)(void* with, const firmware_input* in, firmware_output* out);
  void* with;
  int64_t period; /* ns */
  /* Rows of joint targets, an entry per joint each, and the tick from which on each one holds, in
   * ascending order. They are given as new in every period. */
  const int64_t* row_tick;
  const double* rows;
  int64_t row_count;
  int64_t row;              /* that holds; 0 at first */
  arm_joint_command* joint; /* of the command */
  double* further;          /* of the command */
  const arm_command* command;
  arm_measurement* measurement;
  int64_t tick;        /* where the machine is */
  const int32_t* stop; /* null, or not 0 after a step that ends the run before its period */
} firmware_loop;

/* Progress of a run with a library, for an observer in another process. */
typedef struct firmware_progress {
  int32_t doing; /* the code that runs, and its function */
  int32_t code;  /* with which the run has ended */
  firmware_loop loop;
} firmware_progress;

/* Run so many periods, or fewer if a step ends the run, the machine diverges or a command is
 * refused. Returns the last result of arm_exchange. */
int firmware_loop_run(firmware_loop* loop, int64_t ticks);

/* The step of a library, `with` being what its arm_firmware() returned. */
void firmware_loop_step(void* with, const firmware_input* in, firmware_output* out);

#ifdef __cplusplus
}
#endif

#endif
