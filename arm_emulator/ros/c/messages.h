/* Messages in CDR of which only numbers change, written in place. C99. */
#ifndef MESSAGES_H
#define MESSAGES_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

enum { ROS_SECOND = 1000000000 }; /* ns */

/* ----------------------------------------------------------------------------- messages out */

/* Numbers of a message that are copied from memory, by the kind in which they lie there. */
enum ros_number {
  ROS_SAME = 0,            /* 8 bytes, as they are */
  ROS_UINT32_TO_INT64 = 1, /* what it is, and in the message */
  ROS_INT64_TO_DOUBLE = 2,
  ROS_UINT32_TO_DOUBLE = 3
};

typedef struct ros_copy {
  const void* from;
  int64_t stride; /* bytes from one number to the next */
  int64_t count;
  int64_t kind; /* enum ros_number */
  int64_t at;   /* byte of the message */
} ros_copy;

/* A message in CDR, of which only numbers change, and its publisher. */
typedef struct ros_message {
  const void* publisher; /* rcl_publisher_t */
  uint8_t* data;
  int64_t size;
  int64_t stamp_at, tick_at; /* bytes of its time stamp and its tick; -1: none */
  const ros_copy* copy;
  int64_t copies;
  int64_t number; /* of its topic in the log */
} ros_message;

/* Messages in the order in which they were taken and published, for a record. Each one begins with
 * three numbers of 8 bytes: that of its topic, its size, the wall time [ns]. */
typedef struct ros_log {
  uint8_t* data; /* null: no message is kept */
  int64_t room, used;
  int64_t dropped; /* messages for which there was no room */
} ros_log;

enum { ROS_LOG_HEAD = 24 }; /* bytes before those of a message */

void ros_log_put(ros_log* log, int64_t number, const uint8_t* data, int64_t size);
/* Fill a message with the numbers of a logical time [ns] and a tick, and keep it in a log. */
void ros_fill(ros_message* message, int64_t time, int64_t tick, ros_log* log);

/* ------------------------------------------------------------------------------ messages in */

/* Result of a function that gets a message. */
enum ros_taken { ROS_TAKEN = 0, ROS_FOR_PYTHON = 1 };

#ifdef __cplusplus
}
#endif

#endif
