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

/* One of the arms, for all calls of arm.h but `arm_delete`; null if there are not so many. */
arm_machine* arm_fleet_machine(arm_fleet* fleet, int32_t arm);

/* Advance `arms` arms from `first` on, which is the first of a group, for `rows` rows of voltages
 * [V], `steps` integration steps each; arms without power get 0. The positions after each row go to
 * `q`. Rows are of the whole fleet; only the places of these arms are read and written. An arm that
 * diverges stays at its last sound state, the others go on: ARM_DIVERGED if there is any. */
int arm_fleet_run(arm_fleet* fleet, int32_t first, int32_t arms, const double* voltage,
                  int64_t rows, int64_t steps, double* q);

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

#ifdef __cplusplus
}
#endif

#endif
