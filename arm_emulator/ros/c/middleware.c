#define _POSIX_C_SOURCE 200112L

#include "middleware.h"

#include "bytes.h"

/* ------------------------------------------------------------------------------ messages in */

/* The newest message: one thread of a process runs a ros_wait. */
static rcl_bytes taken;

/* Serve the topics that have messages; returns whether Python has to go on. */
static int serve(ros_wait* wait) {
  const void** ready = ((rcl_subscriptions*)wait->set)->subscriptions;
  int python = 0;
  for (int64_t k = 0; k < wait->topics; ++k) {
    ros_topic* topic = wait->topic + k;
    if (!ready[k]) continue;
    if (!topic->take) {
      topic->ready = python = 1;
      continue;
    }
    if (!ros_take_bytes(topic->subscription, &taken, &wait->message)) continue;
    if (ros_hand_over(topic, &wait->message) == ROS_FOR_PYTHON) {
      wait->left = k;
      return 1;
    }
    ++wait->handled;
  }
  return python;
}

int ros_wait_run(ros_wait* wait, double seconds) {
  const int64_t until = ros_now() + (int64_t)(seconds * ROS_SECOND);
  if (!taken.buffer) taken = ros_no_bytes();
  wait->handled = 0;
  wait->left = -1;
  for (int64_t k = 0; k < wait->topics; ++k) wait->topic[k].ready = 0;
  for (;;) {
    const int64_t left = until - ros_now();
    if (rcl_wait_set_clear(wait->set) != RCL_RET_OK) return ROS_FAILED;
    for (int64_t k = 0; k < wait->topics; ++k)
      if (rcl_wait_set_add_subscription(wait->set, wait->topic[k].subscription, NULL) != RCL_RET_OK)
        return ROS_FAILED;
    const int32_t result = rcl_wait(wait->set, left > 0 ? left : 0);
    if (result == RCL_RET_TIMEOUT) return ROS_TIME_IS_UP;
    if (result != RCL_RET_OK) return ROS_FAILED;
    if (serve(wait)) return ROS_PYTHON;
    if (left <= 0) return ROS_TIME_IS_UP;
  }
}

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
