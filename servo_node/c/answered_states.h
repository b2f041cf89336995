/* The servo's messages in C: motor states and joint targets in, motor commands and joint states
 * out, around servo.c. C99.
 *
 * A message is judged first, which changes nothing but what was read of it. Most lead on at once;
 * of the others Python has something to report, or to do before the servo goes on.
 */
#ifndef ANSWERED_STATES_H
#define ANSWERED_STATES_H

#include "message_reader.h"
#include "messages.h"
#include "servo.h"

#ifdef __cplusplus
extern "C" {
#endif

enum state_verdict {
  STATE_NEXT = 0,
  STATE_REPEATED = 1,
  STATE_RESTARTED =
      2, /* of an emulator that began anew, or of another one: forget what was, go on */
  STATE_MALFORMED = 3,  /* refused by its reader */
  STATE_OFF_TIME = 4,   /* refused: its stamp is not that of its tick */
  STATE_OF_ANOTHER = 5, /* refused: of an emulator that was started later than the one served */
};

enum target_verdict {
  TARGET_DUE = 0,
  TARGET_DUPLICATE = 1,    /* this motion period's, published again */
  TARGET_REPEATED = 2,     /* late: those of the motion period before, published again */
  TARGET_BEFORE_RESET = 3, /* late: an answer to a question before the reset */
  TARGET_MALFORMED = 4,    /* refused by its reader */
  TARGET_OFF_TIME = 5      /* refused: it answers no joint states */
};

typedef struct answered_states {
  uint32_t size;
  int32_t lockstep;
  servo* arm;
  int (*publish)(ros_message*, int64_t time, int64_t tick, ros_log* log);
  /* Readers of motor states and joint targets, and their fields that may be empty. */
  message_reader *state, *target;
  const message_field *applied_field, *brake_field, *v_field, *tau_field;
  /* Numbers of the newest messages. */
  int64_t state_time, target_time; /* ns */
  uint64_t state_tick, state_machine;
  int64_t state_powered;
  /* Numbers of each joint in these messages, and what is published. */
  int64_t *counts, *brake, *movable;
  double *current, *applied, *q, *v, *tau, *aimed, *volts, *q_measured, *v_measured, *tau_measured;
  ros_message *motor_command, *servo_state, *joint_state;
  int64_t machine_at;    /* byte of a motor command that names the emulator */
  int64_t period;        /* ns */
  int64_t motion_ticks;  /* servo periods from one joint target to the next; 0: at any time */
  int64_t report_ticks;  /* servo periods between joint states */
  int64_t longest_quiet; /* ns, wall: an emulator silent for so long may be replaced by another */
  /* The run. Python sets them while no message is taken. */
  int64_t open;               /* 0: all messages are Python's */
  uint64_t machine;           /* the emulator served */
  int64_t tick, powered;      /* -1: no state has come */
  int64_t silent;             /* 1: no motor states come, and the power is cut */
  int64_t waiting;            /* 1: for the joint targets of this motion period */
  int64_t cycle;              /* ns, its begin */
  int64_t cycle_before_reset; /* ns: the same before the reset; -1: without one */
  int64_t now, heard;         /* ns, wall: this moment, and when the newest state came */
  int64_t states, answers;    /* taken and given since Python has set them */
} answered_states;

/* Judge a motor state: enum state_verdict. */
int32_t answered_states_classify(answered_states* own, const uint8_t* data, int64_t size);
/* Go on with the state that was judged last: measure, report, answer. */
void answered_states_accept(answered_states* own);
/* Publish the newest answer again; while targets are waited for, the joint states they answer. */
void answered_states_repeat(answered_states* own);

/* Judge joint targets: enum target_verdict. */
int32_t answered_states_classify_target(answered_states* own, const uint8_t* data, int64_t size);
/* Follow the targets that were judged last, and answer the state that waits for them. */
void answered_states_set_target(answered_states* own);

/* `take` of a ros_topic: the next state. */
int answered_states_receive(void* with, const uint8_t* data, int64_t size);
/* `take` of a ros_topic: targets, in lock-step those that are waited for. */
int answered_states_receive_target(void* with, const uint8_t* data, int64_t size);

#ifdef __cplusplus
}
#endif

#endif
