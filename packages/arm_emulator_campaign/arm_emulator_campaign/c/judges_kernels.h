/* Arguments of the kernels that judge runs on a device, see judges_kernels.hpp. A thread judges a
 * run. Pointers are addresses of the device. */
#ifndef JUDGES_KERNELS_H
#define JUDGES_KERNELS_H

#include "judges.h"

/* Make the judges of each run as copies of some. */
typedef struct judge_build_call {
  judges* all;
  const judges* like;                    /* has rows, inputs and measures on the device */
  const robustness* const* requirements; /* as many as `like` has: their first bytes */
  const int64_t* room_of;                /* bytes of a copy of each */
  double* values;                        /* FORMULA_BLOCK for each run and row */
  const double** at;                     /* one for each run and row */
  robustness** copies;                   /* one for each run and requirement */
  judges_measure* measures;              /* of each run */
  char* rooms;                           /* of each run `room` bytes, for its requirements */
  int64_t room;
} judge_build_call;

typedef struct judge_begin_call {
  judges* all;
} judge_begin_call;

/* Go on with a piece of each run. */
typedef struct judge_add_samples_call {
  judges* all;
  const double* samples; /* of each run `stride` numbers for each of `sample_rows` */
  int64_t sample_rows;
  int64_t stride;
  const int64_t* counts; /* samples of each run */
  const int64_t* since;  /* targets of all runs, see judges_samples */
  const double* targets;
  const int64_t* first; /* place of each run's first target, and the end of all */
  int64_t joints;
  int32_t* failed; /* set to 1 if a requirement has no room for its trace */
} judge_add_samples_call;

typedef struct judge_end_call {
  judges* all;
  double* robustness; /* a row for each run, as the next */
  double* measures;
} judge_end_call;

#endif
