#ifndef _POSIX_C_SOURCE
#define _POSIX_C_SOURCE 200112L
#endif
#include "messages.h"

#include <string.h>
#include <time.h>

static void copy_numbers(uint8_t* data, const ros_copy* copy) {
  const uint8_t* from = copy->from;
  uint8_t* to = data + copy->at;
  for (int64_t k = 0; k < copy->count; ++k, from += copy->stride, to += 8) {
    uint32_t small;
    int64_t integer;
    double real;
    switch (copy->kind) {
      case ROS_SAME:
        memcpy(to, from, 8);
        break;
      case ROS_UINT32_TO_INT64:
        memcpy(&small, from, sizeof small);
        integer = small;
        memcpy(to, &integer, sizeof integer);
        break;
      case ROS_INT64_TO_DOUBLE:
        memcpy(&integer, from, sizeof integer);
        real = (double)integer;
        memcpy(to, &real, sizeof real);
        break;
      default:
        memcpy(&small, from, sizeof small);
        real = small;
        memcpy(to, &real, sizeof real);
    }
  }
}

void ros_log_put(ros_log* log, int64_t number, const uint8_t* data, int64_t size) {
  if (!log || !log->data) return;
  if (log->used + ROS_LOG_HEAD + size > log->room) {
    ++log->dropped;
    return;
  }
  struct timespec wall;
  clock_gettime(CLOCK_REALTIME, &wall);
  const int64_t head[] = {number, size, (int64_t)wall.tv_sec * ROS_SECOND + wall.tv_nsec};
  memcpy(log->data + log->used, head, ROS_LOG_HEAD);
  memcpy(log->data + log->used + ROS_LOG_HEAD, data, (size_t)size);
  log->used += ROS_LOG_HEAD + size;
}

void ros_fill(ros_message* message, int64_t time, int64_t tick, ros_log* log) {
  if (message->stamp_at >= 0) {
    const int32_t sec = (int32_t)(time / ROS_SECOND);
    const uint32_t nanosec = (uint32_t)(time % ROS_SECOND);
    memcpy(message->data + message->stamp_at, &sec, sizeof sec);
    memcpy(message->data + message->stamp_at + sizeof sec, &nanosec, sizeof nanosec);
  }
  if (message->tick_at >= 0) memcpy(message->data + message->tick_at, &tick, sizeof tick);
  for (int64_t k = 0; k < message->copies; ++k) copy_numbers(message->data, message->copy + k);
  ros_log_put(log, message->number, message->data, message->size);
}
