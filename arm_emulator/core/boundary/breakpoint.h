/* A condition on a machine behind arm.h, looked at at the end of each exchange: a breakpoint on
 * physics. C99. */
#ifndef BREAKPOINT_H
#define BREAKPOINT_H

#include "arm.h"
#include "record_ring.h"

#ifdef __cplusplus
extern "C" {
#endif

enum { BREAKPOINT_DEEPEST = 64 }; /* values on the stack */

/* Operations on a stack of numbers; comparisons leave 1 or 0. */
enum breakpoint_code {
  BREAKPOINT_CONSTANT,
  BREAKPOINT_DOUBLE, /* of the row, at `offset` */
  BREAKPOINT_INT64,
  BREAKPOINT_UINT32,
  BREAKPOINT_TOOL, /* position in the world [m], axis `offset` */
  BREAKPOINT_ADD,
  BREAKPOINT_SUBTRACT,
  BREAKPOINT_MULTIPLY,
  BREAKPOINT_DIVIDE,
  BREAKPOINT_ABS,
  BREAKPOINT_SQRT,
  BREAKPOINT_LEAST,
  BREAKPOINT_LARGEST,
  BREAKPOINT_AT_LEAST_0,
  BREAKPOINT_ABOVE_0,
  BREAKPOINT_NOT
};

typedef struct breakpoint_step {
  int32_t code;
  int32_t reserved;
  int64_t offset;
  double value; /* of a constant */
} breakpoint_step;

/* A joint between base and tool, see core/mechanics: a turn about z, or a slide along it, then a
 * turn about x by alpha, one about z by gamma, and p. */
typedef struct breakpoint_joint {
  const double* share; /* of each drive in its position */
  double q_0;          /* of its position [rad or m] */
  double theta_0, cos_alpha, sin_alpha, cos_gamma, sin_gamma;
  double p[3]; /* m */
  int32_t slides;
  int32_t reserved;
} breakpoint_joint;

typedef struct breakpoint {
  uint32_t size;
  int32_t steps; /* 0: it never holds */
  int (*measure)(const arm_machine*, arm_measurement*);
  int (*get_truth)(const arm_machine*, arm_truth*);
  arm_measurement* measurement; /* these write into `row` */
  arm_truth* truth;
  const char* row;
  record_row* head; /* of the row */
  const breakpoint_step* step;
  const breakpoint_joint* joint; /* from the tool's to the first */
  int32_t joints;
  int32_t drives; /* whose positions begin in the row at `q` */
  int64_t q;
  int32_t held; /* 1: it held at the newest tick */
  int32_t hit;  /* 1: it began to hold. Loops stop there; the owner clears it */
  double p[3];  /* of the tool on the link of the first of `joint` [m] */
  double R[9];  /* from the base's axes to the world's, row by row */
  int64_t tick; /* where it began to hold last */
} breakpoint;

/* Whether the condition holds for the machine as it is now. */
int breakpoint_holds(breakpoint* one, const arm_machine* machine);
/* Look at the machine; a listener of arm_listen, `with` being the breakpoint. */
void breakpoint_take(void* with, const arm_machine* machine);

#ifdef __cplusplus
}
#endif

#endif
