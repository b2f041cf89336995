#define _POSIX_C_SOURCE 200112L

#include "middleware.h"

#include "bytes.h"

/* ------------------------------------------------------------------------------ messages in */

int ros_receive(const void* subscription, ros_publisher* owner, ros_received* out) {
  static rcl_bytes received;
  if (!received.buffer) received = ros_no_bytes();
  do
    if (!ros_take_bytes(subscription, &received, out)) return 0;
  while (ros_is_dropped(owner, out));
  return 1;
}

/* ----------------------------------------------------------------------------- messages out */

int ros_send(const ros_message* message) {
  rcl_bytes bytes = ros_no_bytes();
  bytes.buffer = message->data;
  bytes.buffer_length = bytes.buffer_capacity = (size_t)message->size;
  const int32_t result = rcl_publish_serialized_message(message->publisher, &bytes, NULL);
  if (result != RCL_RET_OK) rcutils_reset_error(); /* the context was shut down */
  return result;
}

int ros_publish(ros_message* message, int64_t time, int64_t tick, ros_log* log) {
  ros_fill(message, time, tick, log);
  return ros_send(message);
}
