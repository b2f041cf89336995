/* The servo's messages in C: motor states and joint targets in, motor commands and joint states
 * out, around servo.c. C99. */
#ifndef ANSWERED_STATES_H
#define ANSWERED_STATES_H

#include "messages.h"
#include "servo.h"

#ifdef __cplusplus
extern "C" {
#endif

/* motor_states: what they must be like, and where their numbers lie; -1: absent. */
typedef struct motor_states {
  ros_pattern pattern;
  int64_t stamp_at, tick_at, powered_at, machine_at;
  int64_t counts_at, current_at, applied_at, brakes_at;
  const int64_t* place; /* of each joint of the message, in the servo's order */
} motor_states;

/* joint_targets. */
typedef struct joint_targets {
  ros_pattern pattern;
  int64_t stamp_at, q_at, v_at, tau_at;
  const int64_t* place;
} joint_targets;

/* Bounds of what comes, an entry per joint in the servo's order. */
typedef struct servo_bounds {
  const double *counts, *current, *applied, *brake, *q, *v, *tau;
} servo_bounds;

typedef struct answered_states {
  uint32_t size;
  int32_t lockstep;
  servo* arm;
  void (*measure)(servo*, int64_t, const int64_t*, const double*, const double*);
  void (*brakes)(servo*, const int64_t*);
  void (*aim)(servo*, const double*, const double*, const double*);
  void (*command)(servo*, int32_t, double*);
  int (*publish)(ros_message*, int64_t time, int64_t tick, ros_log* log);
  motor_states in;
  joint_targets wanted;
  servo_bounds most;
  /* Places of what came, and of what is published, an entry per joint. */
  int64_t *counts, *brake, *movable;
  double *current, *applied, *q, *v, *tau, *volts, *q_measured, *v_measured, *tau_measured;
  ros_message *motor_command, *servo_state, *joint_state;
  int64_t period;       /* ns */
  int64_t motion_ticks; /* servo periods from one joint target to the next; 0: at any time */
  int64_t report_ticks; /* servo periods between joint states */
  /* The run. Python sets them while no message is taken. */
  int64_t open;     /* 0: all messages are Python's */
  uint64_t machine; /* the emulator served */
  int64_t tick, powered;
  int64_t waiting;         /* 1: for the joint targets of this motion period */
  int64_t cycle;           /* ns, its begin */
  int64_t states, answers; /* taken and given since Python has set them */
} answered_states;

/* `take` of a ros_topic: the state of the next tick. */
int answered_states_take(void* with, const uint8_t* data, int64_t size);
/* `take` of a ros_topic: targets, in lock-step those that are waited for. */
int answered_states_aim(void* with, const uint8_t* data, int64_t size);

#ifdef __cplusplus
}
#endif

#endif
