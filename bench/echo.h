/* A message that is answered by another, and the time from answer to message. C99. */
#ifndef ECHO_H
#define ECHO_H

#include "messages.h"

typedef struct echo {
  int (*publish)(ros_message*, int64_t time, int64_t tick, ros_log* log);
  ros_message* answer;
  int64_t* took; /* ns */
  int64_t room, rounds;
  int64_t began; /* ns, when the newest answer was published */
} echo;

/* `take` of a ros_topic. */
int echo_take(void* with, const uint8_t* data, int64_t size);

#endif
