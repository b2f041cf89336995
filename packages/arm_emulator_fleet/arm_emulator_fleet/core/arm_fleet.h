/* Many arms of one scene, each with parameters and a state of its own, advanced side by side in the
 * lanes of vector registers. C99; see arm.h, of which everything holds here, too.
 *
 * Arms stand in groups of `arm_fleet_lanes()`. Calls on different groups may come from different
 * threads at the same time. Rows of numbers are of all arms, one after the other, each with its
 * joints: number [arm * joints + joint].
 */
#ifndef ARM_FLEET_H
#define ARM_FLEET_H

#include "arm.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct arm_fleet arm_fleet;

/* Arms that advance together; 1 where the scene's scheme cannot. */
int32_t arm_fleet_lanes(void);

/* Return `count` arms at rest at q = 0, or null if the options make no sense. `parameters` of the
 * options: a row of the varied numbers' values for each arm. */
arm_fleet* arm_fleet_new(const arm_options* options, int32_t count);
void arm_fleet_delete(arm_fleet* fleet);

/* One of the arms, for all calls of arm.h but `arm_delete`; null if there are not so many. Its
 * group is slower until it is given back as often as it was asked for. */
arm_machine* arm_fleet_machine(arm_fleet* fleet, int32_t arm);
void arm_fleet_give_back(arm_fleet* fleet, int32_t arm);

/* Advance `arms` arms from `first` on, which is the first of a group, for `rows` rows of commands
 * [V], `steps` integration steps each; arms without power get 0. The positions after each row go to
 * `q`. Rows are of the whole fleet; only the places of these arms are read and written. An arm that
 * diverges stays at its last sound state, the others go on: ARM_DIVERGED if there is any. */
int arm_fleet_run(arm_fleet* fleet, int32_t first, int32_t arms, const double* command,
                  int64_t rows, int64_t steps, double* q);

/* ------------------------------------------------------------------------- all arms in one call
 *
 * A mask has a byte for each arm: 0 leaves it out; a null mask takes all. Rows are of the whole
 * fleet, those of arms that are left out are not read. A refused call changes nothing: the
 * reason is with `arm_fleet_machine(fleet, arm_fleet_refused(fleet))`, see `arm_why`. */

/* The arm that refused the newest of these calls; -1: none. */
int32_t arm_fleet_refused(const arm_fleet* fleet);

int arm_fleet_reset(arm_fleet* fleet, const uint8_t* mask, const double* q, const double* v);
/* A varied number of each arm. */
int arm_fleet_get_parameter(const arm_fleet* fleet, const char* name, double* values);
int arm_fleet_set_parameter(arm_fleet* fleet, const uint8_t* mask, const char* name,
                            const double* values);
/* All varied numbers at once, a row for each arm in the order of `arm_describe_parameter`: quicker
 * than one after the other. */
int arm_fleet_set_parameters(arm_fleet* fleet, const uint8_t* mask, const double* values);
/* An external wrench of each arm on a link, see `arm_set_external_wrench`. */
int arm_fleet_set_external_wrench(arm_fleet* fleet, const uint8_t* mask, int32_t link,
                                  const arm_wrench* wrench);
/* Power of all drives of each arm; `on` has a byte for each. */
void arm_fleet_power(arm_fleet* fleet, const uint8_t* on);
/* `arm_saved_size()` bytes for each arm of the fleet. */
int arm_fleet_save(const arm_fleet* fleet, void* out, int64_t size);
/* Those bytes, or `arm_saved_size()` bytes of a single arm, from which all of the mask continue. */
int arm_fleet_restore(arm_fleet* fleet, const uint8_t* mask, const void* saved, int64_t size);

/* Readings of the sensors of all arms; every array may be null. */
typedef struct arm_fleet_measurement {
  uint32_t size;
  uint32_t reserved;
  uint8_t* powered;  /* of each arm */
  int64_t* tick;     /* of each arm */
  int64_t* answered; /* of each arm */
  arm_joint_measurement* joint;
  arm_joint_sensors* sensors;
  arm_imu_measurement* imu;
  double* current_d; /* A, along the rotors' flux */
  double* readings;  /* of each arm as in arm_measurement */
  double* further;   /* of each arm as in arm_measurement */
} arm_fleet_measurement;

int arm_fleet_measure(const arm_fleet* fleet, arm_fleet_measurement* out);

/* One servo period of `arms` arms from `first` on, as `arm_fleet_run`, each under its commands of
 * the fleet's row, as `arm_exchange`. `arm_fleet_refused` does not report its refusals: the reason
 * is with the arm. */
int arm_fleet_exchange(arm_fleet* fleet, int32_t first, int32_t arms, const arm_command* command);

/* Rows of all arms; every array may be null. */
typedef struct arm_fleet_truth {
  uint32_t size;
  uint32_t reserved;
  int32_t* fault;      /* of each arm: joint that diverged; -1: none */
  double* time;        /* s, of each arm */
  double* energy;      /* J, of each arm */
  int64_t* encoder;    /* counts at the motors, as their encoders measure them */
  double* current;     /* A */
  double* motor_angle; /* rad */
  double* motor_speed; /* rad/s */
  double* q;
  double* v;
  double* gear_torque; /* N m or N, on the link */
} arm_fleet_truth;

int arm_fleet_get_truth(const arm_fleet* fleet, arm_fleet_truth* out);

/* `periods` servo periods of `arms` arms from `first` on, as `arm_fleet_exchange`, the commands
 * held; then the measurements and the true states. Either may be null. Energy and gear torque take
 * longer than all else together. */
int arm_fleet_step(arm_fleet* fleet, int32_t first, int32_t arms, const arm_command* command,
                   int64_t periods, arm_fleet_measurement* measurement, arm_fleet_truth* truth);

/* Control code in the loop with arms. `step` is called once in every servo period of a group of
 * arms, with the rows `joint` and `powered` of all arrays of the fleet. It writes the commands of
 * these arms, which hold their last values until then. Calls for different arms may
 * come from several threads at a time; it must keep its data per arm. */
typedef void (*arm_fleet_step_of_control)(void* with, int32_t first, int32_t arms,
                                          const arm_joint_measurement* joint,
                                          const uint8_t* powered, arm_joint_command* command);
/* The same in rows of lanes, for control code that is written over vectors: number
 * [joint * lanes + lane] is of arm `first + lane`. Lanes from `arms` on are nobody's. */
typedef struct arm_fleet_rows {
  int32_t first, arms, lanes;
  int32_t reserved;
  const int64_t* encoder; /* counts */
  const int64_t* brake;   /* 1: closed */
  const double* current;  /* A */
  const double* applied;  /* in the period that has passed */
  const uint8_t* powered; /* of each lane */
  double* value;          /* commands, in the mode and with the enabling of `joint` below */
} arm_fleet_rows;
typedef void (*arm_fleet_step_of_rows)(void* with, const arm_fleet_rows* rows);
/* Either of the two functions is null. */
typedef struct arm_fleet_control {
  uint32_t size;
  uint32_t reserved;
  arm_fleet_step_of_control step;
  arm_fleet_step_of_rows step_rows;
  void* with;
  arm_joint_command* joint; /* an entry per joint of each arm */
} arm_fleet_control;

/* A change of an arm's machine between two of its servo periods. */
enum arm_fleet_change_kind {
  ARM_CHANGES_PARAMETER, /* the varied number `place`, to `value` */
  ARM_CHANGES_WRENCH,    /* the external wrench on link `place`, to `wrench` */
  ARM_CHANGES_POWER      /* the power of all drives: off if `value` is 0 */
};
typedef struct arm_fleet_change {
  int64_t tick; /* of the arm, before which it happens */
  int32_t kind;
  int32_t place;
  double value;
  const arm_wrench* wrench;
} arm_fleet_change;

/* The way of arms in `arm_fleet_follow`, beside its control; every pointer may be null. */
typedef struct arm_fleet_way {
  uint32_t size;
  uint32_t reserved;
  double* links; /* a row of all arms for each period: the links' positions after it */
  /* Those of arm k are the entries [first_change[k], first_change[k + 1]), their ticks ascending.
   * Those whose tick has passed are left out. */
  const arm_fleet_change* change;
  const int64_t* first_change;
  /* Called after each period of a group of arms; it may ask for measurements and true states. Calls
   * for different arms may come from several threads at a time. */
  void (*look)(void* with, int32_t first, int32_t arms);
  void* with;
} arm_fleet_way;

/* `periods` servo periods of `arms` arms from `first` on, as `arm_fleet_exchange`, under commands
 * that control code gives in every one; `way` may be null. Then as `arm_fleet_step`; `joint` and
 * `powered` of the measurement must be there. A change that is refused is before anything happens:
 * ARM_REFUSED. A refused command ends the call for its group of arms, alike. `arm_fleet_refused`
 * returns one of them. */
int arm_fleet_follow(arm_fleet* fleet, int32_t first, int32_t arms,
                     const arm_fleet_control* control, int64_t periods, const arm_fleet_way* way,
                     arm_fleet_measurement* measurement, arm_fleet_truth* truth);

#ifdef __cplusplus
}
#endif

#endif
