/* Motions of a machine with their derivatives by its varied numbers and by its initial state. */
#ifndef ARM_SENSITIVITY_H
#define ARM_SENSITIVITY_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* A seed is a row of `arm_directions()` numbers: how much the number before it changes along each
   direction. Of several parts of the directions all seeds of one stand before those of the next. */
typedef struct arm_sensitive_run {
  double step;                   /* s */
  const double* parameters;      /* varied numbers of the scene */
  const double* parameter_seeds; /* a row for each */
  const double* q;               /* of the joints, rad (m) */
  const double* q_seeds;         /* a row for each */
  const double* v;               /* rad/s (m/s) */
  const double* v_seeds;         /* a row for each */
  const double* theta_m;         /* of the motors, rad and rad/s; both null: at rest in the gears */
  const double* omega_m;
  const double* commands; /* rows of the joints' commands, each held for `steps` */
  int64_t rows;
  int64_t steps;
  int64_t parts;
  /* The state at the end of each row of commands: of every joint q, v, then motor current [A],
     angle [rad] and speed [rad/s]. For each of these quantities `values` has a number per joint.
     `slopes` has a row of `stride` numbers per joint: the derivatives of all parts, side by side.
     */
  double* values;
  double* slopes;
  int64_t stride;
} arm_sensitive_run;

int32_t arm_directions(void);

/* Returns the number of rows that were completed: fewer than `rows` if the machine diverged. */
int64_t arm_run_with_sensitivities(const arm_sensitive_run* run);

#ifdef __cplusplus
}
#endif

#endif
