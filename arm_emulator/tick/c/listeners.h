/* Several listeners at the end of each exchange of one machine behind arm.h, which has room for
 * one. C99. */
#ifndef LISTENERS_H
#define LISTENERS_H

#include "arm.h"

#ifdef __cplusplus
extern "C" {
#endif

enum { LISTENERS_MOST = 8 };

typedef struct listener {
  void (*call)(void* with, const arm_machine* machine);
  void* with;
} listener;

typedef struct listeners {
  uint32_t size;
  int32_t count;
  listener each[LISTENERS_MOST];
} listeners;

/* Add one behind the others; 0: there is no room. */
int listeners_add(listeners* all, void (*call)(void* with, const arm_machine* machine), void* with);
/* Take away those that are called with `with`. */
void listeners_remove(listeners* all, const void* with);
/* Call all, in the order in which they were added; a listener of arm_listen, `with` being all. */
void listeners_call(void* with, const arm_machine* machine);

#ifdef __cplusplus
}
#endif

#endif
