/* Bytes of messages for rcl. C99. */
#ifndef BYTES_H
#define BYTES_H

#include "middleware.h"
#include "rcl_calls.h"

/* Monotonic wall time [ns]. */
int64_t ros_now(void);
/* Room of no bytes, which rcl enlarges; its buffer is given back by free(). */
rcl_bytes ros_no_bytes(void);

/* Take the oldest message of an rcl_subscription_t into `bytes`, to which `out` then points; 0:
 * no message has come. */
int ros_take_bytes(const void* subscription, rcl_bytes* bytes, ros_received* out);
/* Whether a message of another publisher is dropped, which is counted. */
int ros_is_dropped(ros_publisher* owner, const ros_received* message);
/* Give a message to the function of its topic if its publisher is the owner, or drop it: enum
 * ros_taken. */
int ros_hand_over(const ros_topic* topic, const ros_received* message);

#endif
