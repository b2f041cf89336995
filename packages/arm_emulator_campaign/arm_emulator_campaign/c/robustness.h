/* Robustness of a requirement over time, sample by sample, without the trace. C99.
 *
 * A requirement is a list of nodes, children first; the last one is its root, asked for at time 0.
 * Times are whole numbers of samples. A window that reaches past the end of the trace has what is
 * within; an empty one is +inf for always and -inf for eventually and until. What is fed are truth
 * values of formula.h, whose rules for undefined ones hold over time, too. */
#ifndef ROBUSTNESS_H
#define ROBUSTNESS_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

enum robustness_kind {
  ROBUSTNESS_ATOM, /* row `left` of what is fed */
  ROBUSTNESS_NOT,  /* of node `left` */
  ROBUSTNESS_AND,  /* of nodes `left` and `right`, as the next two */
  ROBUSTNESS_OR,
  ROBUSTNESS_UNTIL,  /* `left` holds until, from now to `end` later, `right` does */
  ROBUSTNESS_ALWAYS, /* `left`, from `begin` to `end` later */
  ROBUSTNESS_EVENTUALLY,
};

#define ROBUSTNESS_FOREVER -1

typedef struct robustness_node {
  int32_t kind;
  int32_t left;
  int32_t right;
  int32_t reserved;
  int64_t begin; /* samples */
  int64_t end;   /* samples; ROBUSTNESS_FOREVER: the end of the trace */
} robustness_node;

typedef struct robustness robustness;

/* A requirement at the start of a trace; null without memory for it. */
robustness* robustness_new(const robustness_node* nodes, int32_t count);
void robustness_delete(robustness* one);
/* Go on with so many samples of each row. Returns 0, or -1 without memory. */
int robustness_feed(robustness* one, const double* const* rows, int64_t samples);
/* Return the margin of the trace, which ends, and begin anew; NaN where it is undefined, without
 * memory or samples. */
double robustness_end(robustness* one);

/* Bytes of `one` without its memory of a trace (`head`). Bytes of a copy for traces of up to
 * `longest` samples, which has been fed so many (`whole`). */
void robustness_measure(robustness* one, int64_t longest, int64_t* head, int64_t* whole);
/* Return a copy at the start of a trace in this room, never to be deleted: `one` may be its first
 * bytes alone, wherever they came from. Feeding it more samples is refused. It must be fed blocks
 * of FORMULA_BLOCK, as `one` has been; the last one of a trace may be shorter. */
robustness* robustness_copy(const robustness* one, void* room);

#ifdef __cplusplus
}
#endif

#endif
