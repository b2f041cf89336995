#include "bytes.h"

#include <stdlib.h>
#include <string.h>

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
  return 1;
}

int ros_hand_over(const ros_topic* topic, const ros_received* message) {
  if (topic->owner && memcmp(topic->owner, message->publisher, ROS_GID)) return ROS_FOR_PYTHON;
  return topic->take(topic->with, message->data, message->size);
}
