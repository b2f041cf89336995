/* A condition that is looked at at the end of each exchange: a breakpoint on physics. C99. */
#ifndef BREAKPOINT_H
#define BREAKPOINT_H

#include "condition.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct breakpoint {
  uint32_t size;
  int32_t held; /* 1: it held at the newest tick */
  int32_t hit;  /* 1: it began to hold. Loops stop there; the owner clears it */
  int32_t reserved;
  condition* what;
  int64_t tick; /* where it began to hold last */
} breakpoint;

/* Look at the machine; a listener of arm_listen, `with` being the breakpoint. */
void breakpoint_take(void* with, const arm_machine* machine);

#ifdef __cplusplus
}
#endif

#endif
