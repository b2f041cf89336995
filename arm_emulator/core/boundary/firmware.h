/* Your control code in the loop with a machine behind arm.h: functions of your shared library.
 *
 *   python -m arm_emulator run SCENE --servo ./libmine.so --targets table.csv
 *
 * The library exports `arm_firmware`, which returns the functions `start`, called once before the
 * first servo period, and `step`, called in every one. No other thread calls them. Logical time
 * stands still meanwhile, so they may take any time, also in a debugger. C99.
 */
#ifndef FIRMWARE_H
#define FIRMWARE_H

#include "arm.h"

#ifdef __cplusplus
extern "C" {
#endif

#define FIRMWARE_VERSION 1

/* Description of the machine, given once. */
typedef struct firmware_machine {
  uint32_t size;
  int32_t joints;
  int64_t period; /* ns, from step to step */
  double supply_voltage;
  const arm_joint_description* joint; /* an entry per joint, base to tool, as in all arrays */
} firmware_machine;

/* Measurements and targets at the start of a servo period. */
typedef struct firmware_input {
  uint32_t size;
  int32_t new_targets; /* 1: joint targets have come */
  int64_t time;        /* ns, tick times period */
  const arm_measurement* measured;
  const double* q_target; /* rad or m, of the links; null: no target yet */
  const double* v_target; /* rad/s or m/s, their derivative; null: 0 */
  const double* tau;      /* N m or N, feed-forward at the links; null: 0 */
  int32_t new_row;        /* 1: a row of the table of targets begins here */
  int32_t reserved;
} firmware_input;

/* Commands of the drives for the period. The arrays keep the values written last: at first every
 * joint is enabled, its value 0, in the first mode of its drive. */
typedef struct firmware_output {
  uint32_t size;
  uint32_t reserved;
  arm_joint_command* joint; /* an entry per joint */
  double* further;          /* rows as in arm_command */
} firmware_output;

typedef struct firmware {
  uint32_t version; /* FIRMWARE_VERSION */
  uint32_t reserved;
  /* Start or restart. Return null, or a line with the reason if you cannot drive this machine. May
   * be null. */
  const char* (*start)(const firmware_machine* machine);
  void (*step)(const firmware_input* in, firmware_output* out);
} firmware;

/* The entry point; your library defines it. */
const firmware* arm_firmware(void);

#ifdef __cplusplus
}
#endif

#endif
