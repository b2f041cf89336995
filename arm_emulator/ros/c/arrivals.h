/* Messages taken in C where they arrive: in the middleware's own thread, without another that is
 * woken, and without a wait set. C99.
 *
 * While the arrivals are open, each message of their topics is handed to its `take` directly. The
 * first one that is Python's closes them: it is kept, those behind it wait in the middleware, and
 * a guard condition wakes Python.
 */
#ifndef ARRIVALS_H
#define ARRIVALS_H

#include "middleware.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct ros_arrivals ros_arrivals;

typedef struct ros_arrived {
  int64_t handled;      /* messages taken in C so far */
  int64_t left;         /* topic of the message that was left to Python; -1: none */
  ros_received message; /* that one, until the arrivals open again */
} ros_arrived;

/* Arrivals on some topics, which outlive them, closed; `guard` is an rcl_guard_condition_t. Null:
 * the middleware does not report arrivals, or there is no memory. */
ros_arrivals* ros_arrivals_new(ros_topic* topic, int64_t topics, void* guard);
/* No message is being taken when this returns. */
void ros_arrivals_delete(ros_arrivals* arrivals);
/* Take what has come meanwhile, and what comes from now on; 0: a message was left to Python. */
int ros_arrivals_open(ros_arrivals* arrivals);
/* No message is taken from when this returns until they open again. */
void ros_arrivals_close(ros_arrivals* arrivals, ros_arrived* out);

#ifdef __cplusplus
}
#endif

#endif
