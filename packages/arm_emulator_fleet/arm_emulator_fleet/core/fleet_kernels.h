/* Arguments of the kernels of a fleet, which are functions of a card: see fleet_kernels.hpp. Every
 * kernel has the name of its struct without `_call`, and a thread for each group of arms. Pointers
 * are addresses of the card. Rows and masks are of the whole fleet, as in arm_fleet.h.
 */
#ifndef FLEET_KERNELS_H
#define FLEET_KERNELS_H

#include "arm_fleet.h"
#include "servo_fleet.h"

/* The lowest arm that refused goes to `refused[0]` before anything has changed, and to `refused[1]`
 * where it came during the motion; both are INT32_MAX without any. Kernels that have this pointer
 * and change arms do nothing if `refused[0]` is an arm. */
#define FLEET_NONE_REFUSED 2147483647

/* Room that a fleet of `count` arms needs; one thread. */
typedef struct fleet_measure_memory_call {
  int32_t count;
  int32_t reserved;
  /* Bytes: of the fleet, of its places, of a group with its arms, of a step's half; its lanes;
   * whether it looks for modes or events, and does so in lanes. */
  int64_t* bytes;
} fleet_measure_memory_call;

/* Make a fleet without arms; one thread. Then make its arms. */
typedef struct fleet_begin_call {
  arm_fleet* fleet; /* room for it */
  arm_options options;
  int32_t count;
  int32_t reserved;
} fleet_begin_call;
typedef struct fleet_build_call {
  arm_fleet* fleet;
  arm_options options;
  int64_t* saved_size; /* bytes of a saved arm */
} fleet_build_call;
/* Give back what processors have in their heap; one thread. */
typedef struct fleet_end_call {
  arm_fleet* fleet;
} fleet_end_call;

typedef struct fleet_check_start_call {
  arm_fleet* fleet;
  const uint8_t* mask;
  const double *q, *v;
  const double* bounds; /* largest q of each joint, then largest v */
  int32_t* refused;
} fleet_check_start_call;
typedef fleet_check_start_call fleet_reset_call;

/* Varied numbers: all of them in rows, or number `place` alone if it is not negative. */
typedef struct fleet_get_parameters_call {
  const arm_fleet* fleet;
  int64_t place;
  double* values;
} fleet_get_parameters_call;
typedef struct fleet_check_parameters_call {
  arm_fleet* fleet;
  const uint8_t* mask;
  int64_t place;
  const double* values;
  int32_t* refused;
} fleet_check_parameters_call;
typedef fleet_check_parameters_call fleet_set_parameters_call;

typedef struct fleet_set_wrench_call {
  arm_fleet* fleet;
  const uint8_t* mask;
  int64_t link;
  const arm_wrench* wrench;
} fleet_set_wrench_call;

typedef struct fleet_power_call {
  arm_fleet* fleet;
  const uint8_t* on;
} fleet_power_call;

typedef struct fleet_save_call {
  const arm_fleet* fleet;
  uint8_t* saved;
  int64_t size; /* of each arm */
} fleet_save_call;
/* One arm alone; one thread. */
typedef struct fleet_save_arm_call {
  const arm_fleet* fleet;
  int64_t arm;
  uint8_t* saved;
} fleet_save_arm_call;
typedef struct fleet_check_saved_call {
  arm_fleet* fleet;
  const uint8_t* mask;
  const uint8_t* saved;
  int64_t size;   /* of each arm */
  int64_t stride; /* from arm to arm; 0: all take the same */
  int32_t* refused;
} fleet_check_saved_call;
typedef fleet_check_saved_call fleet_restore_call;

/* Why arm `arm` refused; one thread. */
typedef struct fleet_get_refusal_call {
  const arm_fleet* fleet;
  int64_t arm;
  arm_refusal* why;
} fleet_get_refusal_call;

/* Time goes on: steps under `periods` rows of commands, servo periods under held commands, or servo
 * periods under control code. Control code needs `joint` and `powered` of the measurement.
 *
 * Without a queue `fleet_advance` does it all. With one, two kernels take each period: in
 * `fleet_advance_to_event` every group goes on up to its first event, and queues if something is
 * left of its period. `fleet_advance` takes the queue, so that threads with events stand side by
 * side, and others do not wait for them. */
enum fleet_motion { FLEET_UNDER_ROWS, FLEET_UNDER_HELD_COMMANDS, FLEET_UNDER_CONTROL };
typedef struct fleet_advance_call {
  arm_fleet* fleet;
  int64_t motion; /* enum fleet_motion */
  const double* command;
  int64_t steps; /* of a row */
  double* q;
  arm_joint_command* joint;
  const double* further;
  int64_t tick, periods;
  arm_fleet_step_of_control step; /* of the control code, or that of rows; of neither: servos */
  arm_fleet_step_of_rows step_rows;
  void* with;
  arm_fleet_way way;
  arm_fleet_measurement measurement; /* where control code measures */
  int32_t* refused;
  int64_t period; /* of the call, with a queue */
  /* Number of groups that queue in even periods, and in odd ones; then the groups. Null: none. */
  int32_t* queue;
} fleet_advance_call;
#define FLEET_QUEUE_BEGINS 2
typedef fleet_advance_call fleet_advance_to_event_call;
typedef fleet_advance_call fleet_check_commands_call;
typedef fleet_advance_call fleet_check_changes_call;

/* Measurements and true states, of each if its size is not 0; `refused` may be null. */
typedef struct fleet_observe_call {
  const arm_fleet* fleet;
  arm_fleet_measurement measurement;
  arm_fleet_truth truth;
  const int32_t* refused;
} fleet_observe_call;

/* One number of each joint, which lie apart, one after the other; a thread for each of them. Whole
 * numbers of `size` bytes become int64_t. */
typedef struct fleet_gather_call {
  const uint8_t* given;
  int64_t size;
  int64_t shape[3], stride[3];
  void* to;
} fleet_gather_call;

/* Values of commands, where the arms' commands are. */
typedef struct fleet_put_commands_call {
  arm_fleet* fleet;
  const double* value;
  arm_joint_command* joint;
} fleet_put_commands_call;

/* Let the function of a way look at the arms as they are. */
typedef struct fleet_look_call {
  const arm_fleet* fleet;
  arm_fleet_way way;
} fleet_look_call;

/* Servos of a fleet: room for a group of arms, its joints and the struct of both; then as
 * servo_fleet.h. */
typedef struct servos_measure_memory_call {
  int64_t* bytes;
} servos_measure_memory_call;
typedef struct servos_begin_call {
  servo_fleet* servos;
  int64_t arms;
} servos_begin_call;
typedef struct servos_reset_call {
  servo_fleet* servos;
  int64_t arms;
  const uint8_t* mask;
} servos_reset_call;
typedef servos_begin_call servos_aim_call;
typedef struct servos_retune_call {
  servo_fleet* servos;
  int64_t arm;
  const servo_joint* joint;
} servos_retune_call;

#endif
