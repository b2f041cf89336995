/* One servo period of a machine behind arm.h, for every door. C99.
 *
 * A period is two calls: `tick_measure` gives the measurement of the present tick, `tick_exchange`
 * takes the command that answers it. A door that is driven from outside makes these calls itself; a
 * door that owns its loop is a controller of `tick_run`. What reads the machine and answers nothing
 * is a listener of arm_listen. Nothing else calls arm_exchange.
 *
 * The result of a command is the same at every door: a refused one has changed nothing, a
 * machine that diverged stays at its last sound state, and in both cases the tick is not left.
 */
#ifndef TICK_H
#define TICK_H

#include "arm.h"

#ifdef __cplusplus
extern "C" {
#endif

/* A machine, the functions of its library, and where it is. */
typedef struct tick_machine {
  uint32_t size;
  int32_t joints;
  arm_machine* machine;
  int (*measure)(const arm_machine*, arm_measurement*);
  int (*exchange)(arm_machine*, const arm_command*, arm_measurement*);
  int (*get_truth)(const arm_machine*, arm_truth*);
  int64_t period;               /* ns */
  arm_measurement* measurement; /* newest */
  int64_t tick;                 /* present one */
  /* Not 0, as a breakpoint (condition.h) sets it at the end of a period: loops end behind that;
   * null: never. */
  const int32_t* stop;
} tick_machine;

/* Read the measurement of this tick. */
int tick_measure(tick_machine* at);
/* Go through a period; with ARM_OK, the result of arm_exchange, the next tick is reached. */
int tick_exchange(tick_machine* at, const arm_command* command);
/* Whether loops are to end. */
int tick_stops(const tick_machine* at);

/* A door that answers measurements with commands. */
typedef struct tick_controller {
  void* with;
  /* Return the command for the period to come, or null: the run ends at this tick. */
  const arm_command* (*answer)(void* with, const tick_machine* at);
  /* Take the result of the period, with the measurement at its end, or that of a machine that has
   * diverged before; null: nothing is done. */
  void (*take)(void* with, const tick_machine* at, int result);
} tick_controller;

/* Go through so many periods, or fewer: until the controller or `stop` ends the run, or a result is
 * not ARM_OK. Returns the newest result. */
int tick_run(tick_machine* at, const tick_controller* controller, int64_t periods);

#ifdef __cplusplus
}
#endif

#endif
