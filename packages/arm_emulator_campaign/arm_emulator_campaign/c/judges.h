/* All that judges the runs of a campaign: arithmetic of signals that is computed once for all
 * requirements and measures, block by block. C99. */
#ifndef JUDGES_H
#define JUDGES_H

#include "formula.h"
#include "robustness.h"

#ifdef __cplusplus
extern "C" {
#endif

enum judges_input_kind {
  JUDGES_SAMPLE, /* row `place` of the samples */
  JUDGES_TARGET, /* joint `place` of the target that holds */
  JUDGES_TICK    /* number of the sample */
};

enum judges_reduction { JUDGES_MAX, JUDGES_MIN, JUDGES_MEAN, JUDGES_RMS, JUDGES_LAST };

typedef struct judges_input {
  int32_t kind;
  int32_t place;
} judges_input;

typedef struct judges_measure {
  int32_t reduction;
  int32_t row;
  double found; /* extremum, sum or last value so far */
} judges_measure;

/* Samples in a piece; targets: `since` has the samples, ascending from at most the first one, from
 * which each row of `targets` holds. */
typedef struct judges_samples {
  int64_t count;
  int64_t stride; /* of a row */
  const double* rows;
  const int64_t* since;
  const double* targets;
  int64_t target_count;
  int64_t joints;
} judges_samples;

typedef struct judges {
  uint32_t size;
  int32_t row_count, requirement_count, measure_count, kept_count;
  int32_t reserved;
  const formula_row* rows;
  const judges_input* inputs;      /* what FORMULA_INPUT numbers */
  double* values;                  /* FORMULA_BLOCK for each row */
  const double** at;               /* of each row: where its block is */
  robustness* const* requirements; /* over these rows */
  judges_measure* measures;
  const int32_t* kept_rows;
  double* kept; /* `kept_stride` for each of them: the values of the newest piece */
  int64_t kept_stride;
  int64_t taken;  /* samples so far */
  int64_t target; /* place of the one that held at the start of the newest block */
} judges;

/* Begin several runs. */
void judges_begin(judges* all, int32_t runs);
/* Go on with a piece of each of several runs. Returns 0, or -1 without memory. */
int judges_add_samples(judges* all, int32_t runs, const judges_samples* pieces);
/* Fill the robustness of each requirement and the value of each measure, a row for each run. */
void judges_end(judges* all, int32_t runs, double* robustness, double* measures);

#ifdef __cplusplus
}
#endif

#endif
