/* The emulator's messages in real time, without Python: a thread publishes what a real-time loop
 * has reached, and commands are given to that loop where they arrive. C99. */
#ifndef REAL_TIME_TICKS_H
#define REAL_TIME_TICKS_H

#include "answers.h"
#include "motor_commands.h"
#include "real_time.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct real_time_locks real_time_locks;

typedef struct real_time_ticks {
  uint32_t size;
  int32_t reserved;
  /* The loop, the functions of its library, and its second reader: this. */
  arm_real_time* loop;
  int (*take)(arm_real_time*, int32_t reader, arm_snapshot* out);
  void (*give)(arm_real_time*, const arm_command*);
  int32_t descriptor, reader;
  int (*send)(const ros_message*);
  arm_snapshot* snapshot; /* published newest: the messages are filled from its arrays */
  /* Published at each tick, and at each tick that is a multiple of `report_ticks`. */
  ros_message *motor_state, *joint_state, *clock;
  int64_t report_ticks;
  motor_commands commands;
  arm_joint_command* joint; /* of the command */
  arm_command* command;
  tick_answers* answers;
  int64_t open;           /* 0: all commands are Python's */
  const tick_machine* at; /* where its `stop` ends the loop, Python has to look */
  int32_t closing;        /* 1: `run` returns */
  /* Guarded by the locks. */
  real_time_locks* locks;
  int64_t tick; /* published newest */
  ros_log log;
} real_time_ticks;

/* 0: no memory. */
int real_time_ticks_begin(real_time_ticks* ticks);
void real_time_ticks_end(real_time_ticks* ticks);

/* Publish what the loop reaches, until there is something for Python, a fault or a stop: returns 1;
 * or until `closing`: 0. */
int real_time_ticks_run(real_time_ticks* ticks);
/* Publish what the loop has reached; returns 1 if there is something for Python. */
int real_time_ticks_catch_up(real_time_ticks* ticks);

/* `take` of a ros_topic: commands newer than those before. */
int real_time_ticks_receive(void* with, const uint8_t* data, int64_t size);
/* The machine was put to a tick, which Python publishes. */
void real_time_ticks_set_tick(real_time_ticks* ticks, int64_t tick);
/* Exchange the log for another one of the same room. */
void real_time_ticks_exchange_log(real_time_ticks* ticks, ros_log* other);

#ifdef __cplusplus
}
#endif

#endif
