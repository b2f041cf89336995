#ifndef _POSIX_C_SOURCE
#define _POSIX_C_SOURCE 200112L
#endif
#include "real_time_ticks.h"

#include <poll.h>
#include <pthread.h>
#include <stdlib.h>
#include <unistd.h>

enum { LOOK_UP = 100 }; /* ms: time after which a quiet thread looks whether it is to end */

struct real_time_locks {
  pthread_mutex_t publishing; /* one thread takes and publishes at a time */
  pthread_mutex_t numbers;    /* held for some copies only */
};

int real_time_ticks_begin(real_time_ticks* ticks) {
  ticks->locks = malloc(sizeof *ticks->locks);
  if (!ticks->locks) return 0;
  pthread_mutex_init(&ticks->locks->publishing, NULL);
  pthread_mutex_init(&ticks->locks->numbers, NULL);
  return 1;
}

void real_time_ticks_end(real_time_ticks* ticks) {
  if (!ticks->locks) return;
  pthread_mutex_destroy(&ticks->locks->publishing);
  pthread_mutex_destroy(&ticks->locks->numbers);
  free(ticks->locks);
  ticks->locks = NULL;
}

/* ----------------------------------------------------------------------------------- states */

static void publish(real_time_ticks* ticks) {
  const int64_t tick = ticks->snapshot->tick, time = tick * ticks->at->period;
  ros_message* const messages[] = {ticks->motor_state, ticks->joint_state, ticks->clock};
  const int count = tick % ticks->report_ticks ? 1 : 3;
  for (int k = 0; k < count; ++k) ros_fill(messages[k], time, tick, NULL);
  pthread_mutex_lock(&ticks->locks->numbers);
  ticks->tick = tick; /* first: the answer may arrive before the send returns */
  for (int k = 0; k < count; ++k)
    ros_log_put(&ticks->log, messages[k]->number, messages[k]->data, messages[k]->size);
  pthread_mutex_unlock(&ticks->locks->numbers);
  for (int k = 0; k < count; ++k) ticks->send(messages[k]);
}

int real_time_ticks_catch_up(real_time_ticks* ticks) {
  int for_python = 0;
  pthread_mutex_lock(&ticks->locks->publishing);
  while (ticks->take(ticks->loop, ticks->reader, ticks->snapshot)) {
    if (ticks->snapshot->truth.fault >= 0)
      for_python = 1; /* it has not reached another tick */
    else
      publish(ticks);
    if (tick_stops(ticks->at)) for_python = 1;
  }
  pthread_mutex_unlock(&ticks->locks->publishing);
  return for_python;
}

int real_time_ticks_run(real_time_ticks* ticks) {
  while (!__atomic_load_n(&ticks->closing, __ATOMIC_ACQUIRE)) {
    struct pollfd bell = {.fd = ticks->descriptor, .events = POLLIN};
    if (poll(&bell, 1, LOOK_UP) <= 0) continue;
    uint64_t rung;
    if (read(ticks->descriptor, &rung, sizeof rung) < 0) continue;
    if (real_time_ticks_catch_up(ticks)) return 1;
  }
  return 0;
}

/* --------------------------------------------------------------------------------- commands */

int real_time_ticks_receive(void* with, const uint8_t* data, int64_t size) {
  real_time_ticks* ticks = with;
  const motor_commands* commands = &ticks->commands;
  if (!ticks->open) return ROS_FOR_PYTHON;
  const int64_t answered = motor_commands_read(&ticks->commands, data, size);
  if (answered < 0) return ROS_FOR_PYTHON;
  pthread_mutex_lock(&ticks->locks->numbers);
  const int result = tick_answers_take(ticks->answers, ticks->tick, answered, commands->came);
  if (result == ANSWER_NEW) ros_log_put(&ticks->log, commands->number, data, size);
  pthread_mutex_unlock(&ticks->locks->numbers);
  if (result != ANSWER_NEW) return ROS_FOR_PYTHON;
  for (int32_t j = 0; j < ticks->at->joints; ++j) ticks->joint[j].value = commands->came[j];
  ticks->command->tick = answered;
  ticks->give(ticks->loop, ticks->command);
  return ROS_TAKEN;
}

void real_time_ticks_set_tick(real_time_ticks* ticks, int64_t tick) {
  pthread_mutex_lock(&ticks->locks->numbers);
  ticks->tick = tick;
  pthread_mutex_unlock(&ticks->locks->numbers);
}

void real_time_ticks_exchange_log(real_time_ticks* ticks, ros_log* other) {
  pthread_mutex_lock(&ticks->locks->numbers);
  const ros_log full = ticks->log;
  ticks->log = *other;
  *other = full;
  pthread_mutex_unlock(&ticks->locks->numbers);
}
