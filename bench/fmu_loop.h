/* Servo period of an importer of FMI 3.0, and the same through tick.h, for fmu.py. C99. */
#ifndef FMU_LOOP_H
#define FMU_LOOP_H

#include "tick.h"

/* Load the unit's binary and bring an instance of a token to step mode; 0 if anything fails. */
void* begin_fmi(const char* binary, const char* token);
/* `steps` steps of `periods` servo periods from `time` on; the time of the end, or -1. */
double run_fmi(void* instance, double time, double period, int64_t periods, int64_t steps,
               uint32_t command, const double* values, uint32_t encoder, int64_t* counts,
               int64_t joints);
void end_fmi(void* instance);

int run_arm(tick_machine* at, const arm_command* command, int64_t periods);

#endif
