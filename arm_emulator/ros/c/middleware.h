/* Messages taken and published through rcl on the handles of rclpy. C99.
 *
 * A process that has imported rclpy has librcl loaded; the library of this header finds its
 * functions there. */
#ifndef MIDDLEWARE_H
#define MIDDLEWARE_H

#include "messages.h"

#ifdef __cplusplus
extern "C" {
#endif

/* ------------------------------------------------------------------------------ messages in */

enum { ROS_GID = 16 }; /* bytes that identify a publisher */

/* A message, and its publisher. */
typedef struct ros_received {
  const uint8_t* data; /* its bytes, until the next message is taken from the same place */
  int64_t size;
  uint8_t publisher[ROS_GID];
  int64_t number; /* that its publisher has given it; -1: the middleware gives none */
  int64_t sent;   /* ns, wall time of its publication */
} ros_received;

/* The one publisher of a topic whose messages are taken. */
typedef struct ros_publisher {
  uint8_t id[ROS_GID];
  int64_t quiet_until; /* ns, monotonic: until then messages of others are dropped, and counted */
  int64_t dropped;
} ros_publisher;

/* A subscription, and the function that takes its messages. */
typedef struct ros_topic {
  const void* subscription; /* rcl_subscription_t */
  ros_publisher* owner;     /* whose messages are taken in C; null: those of any */
  /* Takes the bytes of a message, or leaves it, unchanged, to Python: enum ros_taken. */
  int (*take)(void* with, const uint8_t* data, int64_t size);
  void* with;
} ros_topic;

/* Take the oldest message of an rcl_subscription_t that is not dropped because of its publisher; 0:
 * no message has come. For one thread at a time. */
int ros_receive(const void* subscription, ros_publisher* owner, ros_received* out);

/* ----------------------------------------------------------------------------- messages out */

/* Publish a message as it is filled. Returns 0, or what rcl returned. */
int ros_send(const ros_message* message);
/* `ros_fill`, and `ros_send`. */
int ros_publish(ros_message* message, int64_t time, int64_t tick, ros_log* log);

#ifdef __cplusplus
}
#endif

#endif
