#ifndef _POSIX_C_SOURCE
#define _POSIX_C_SOURCE 200112L
#endif
#include "bytes.h"

#include <stdlib.h>
#include <string.h>
#include <time.h>

static void* new_bytes(size_t size, void* state) {
  (void)state;
  return malloc(size);
}

static void delete_bytes(void* bytes, void* state) {
  (void)state;
  free(bytes);
}

static void* resized_bytes(void* bytes, size_t size, void* state) {
  (void)state;
  return realloc(bytes, size);
}

static void* zero_bytes(size_t number, size_t size, void* state) {
  (void)state;
  return calloc(number, size);
}

int64_t ros_now(void) {
  struct timespec time;
  clock_gettime(CLOCK_MONOTONIC, &time);
  return (int64_t)time.tv_sec * ROS_SECOND + time.tv_nsec;
}

rcl_bytes ros_no_bytes(void) {
  const rcl_allocator allocator = {new_bytes, delete_bytes, resized_bytes, zero_bytes, NULL};
  const rcl_bytes none = {NULL, 0, 0, allocator};
  return none;
}

int ros_take_bytes(const void* subscription, rcl_bytes* bytes, ros_received* out) {
  rcl_message_info info;
  if (rcl_take_serialized_message(subscription, bytes, &info, NULL) != RCL_RET_OK) {
    rcutils_reset_error(); /* none is left, or another process has taken it back */
    return 0;
  }
  out->data = bytes->buffer;
  out->size = (int64_t)bytes->buffer_length;
  memcpy(out->publisher, info.publisher_gid.data, ROS_GID);
  out->number = (int64_t)info.publication_sequence_number;
  out->sent = info.source_timestamp;
  return 1;
}

static int is_of_owner(const ros_publisher* owner, const ros_received* message) {
  return !owner || !memcmp(owner->id, message->publisher, ROS_GID);
}

int ros_is_dropped(ros_publisher* owner, const ros_received* message) {
  if (is_of_owner(owner, message) || ros_now() >= owner->quiet_until) return 0;
  ++owner->dropped;
  return 1;
}

int ros_hand_over(const ros_topic* topic, const ros_received* message) {
  if (is_of_owner(topic->owner, message))
    return topic->take(topic->with, message->data, message->size);
  return ros_is_dropped(topic->owner, message) ? ROS_TAKEN : ROS_FOR_PYTHON;
}
