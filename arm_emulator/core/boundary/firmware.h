/* Control code of yours in the loop with a machine behind arm.h: what your shared library has.
 *
 *   python -m arm_emulator run SCENE --servo ./libmine.so --targets table.csv
 *
 * A library has one function of a name that is known outside, `arm_firmware`, which returns what it
 * does: `start` once before the first servo period, then `step` in every one. No other thread calls
 * it, and logical time stands still meanwhile: it may take as long as it likes, in a debugger too.
 * C99.
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
  const double* q_target; /* rad or m, of the links; null: none has come yet */
  const double* v_target; /* rad/s or m/s, with which they go on; null: 0 */
  const double* tau;      /* N m or N, of the links, known beforehand; null: 0 */
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
  /* Begin anew. Return null, or in one line why you cannot drive this machine. May be null. */
  const char* (*start)(const firmware_machine* machine);
  void (*step)(const firmware_input* in, firmware_output* out);
} firmware;

/* The entry point; your library defines it. */
const firmware* arm_firmware(void);

#ifdef __cplusplus
}
#endif

#endif
