/* Lock-step in C: a motor command that answers the present tick leads through a servo period to
 * the next motor state. C99. */
#ifndef ANSWERED_TICKS_H
#define ANSWERED_TICKS_H

#include "answers.h"
#include "motor_commands.h"
#include "tick.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct answered_ticks {
  uint32_t size;
  int32_t reserved;
  tick_machine* at;
  tick_answers* answers;
  arm_joint_command* joint; /* of the command */
  arm_command* command;
  arm_truth* truth;
  motor_commands commands;
  /* Published at each tick, and at each tick that is a multiple of `report_ticks`. */
  int (*publish)(ros_message*, int64_t time, int64_t tick, ros_log* log);
  ros_message *motor_state, *joint_state, *clock;
  int64_t report_ticks;
  ros_log* log;
  /* The run. Python sets them while no message is taken. */
  int64_t last;   /* tick that is not left: the command that answers it is Python's */
  int64_t result; /* of the newest exchange */
} answered_ticks;

/* `take` of a ros_topic: go through a servo period, unless the message or the time is unusual. */
int answered_ticks_receive(void* with, const uint8_t* data, int64_t size);

#ifdef __cplusplus
}
#endif

#endif
