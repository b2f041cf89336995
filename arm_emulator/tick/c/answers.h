/* The commands of one run of a machine: which of them answers a tick. C99.
 *
 * In lock-step a tick is left only with the command that answers it; in real time the newest one
 * holds. One rule serves the commands that arrive in C and those that arrive in Python.
 */
#ifndef TICK_ANSWERS_H
#define TICK_ANSWERS_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

typedef struct tick_answers {
  uint32_t size;
  int32_t lockstep;
  int64_t numbers;           /* of a command: one per joint, then those of further inputs */
  int64_t left;              /* the tick at which the run before was left; -1: none */
  int64_t known;             /* commands of this run that are kept, at most 2 */
  int64_t tick, tick_before; /* that the newest command answers, and the one before; -1: none */
  double *newest, *before;
} tick_answers;

/* Kinds of commands at a tick. All but a new one change nothing. */
enum {
  ANSWER_NEW,
  ANSWER_REPEATED,     /* its bits are known for one of the two ticks answered last */
  ANSWER_BEFORE_RESET, /* the command was on its way when the run before was left */
  ANSWER_FUTURE,
  ANSWER_STALE
};

/* Take a command for `tick` when the machine is at the tick `now`. */
int tick_answers_take(tick_answers* answers, int64_t now, int64_t tick, const double* command);

#ifdef __cplusplus
}
#endif

#endif
