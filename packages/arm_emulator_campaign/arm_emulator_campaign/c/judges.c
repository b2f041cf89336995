#include "judges.h"

#include <math.h>
#include <string.h>

/* NaN stays NaN. */
static double smaller(double a, double b) { return a < b || isnan(a) ? a : b; }
static double larger(double a, double b) { return a > b || isnan(a) ? a : b; }

/* Have the processor fetch a block that comes next: samples of many runs are not in its caches. */
static void fetch(const double* block) {
#ifdef __GNUC__
  for (int i = 0; i < FORMULA_BLOCK; i += 8) __builtin_prefetch(block + i);
#else
  (void)block;
#endif
}

/* The place of the target that holds at a sample, from one before it on. */
static int64_t target_at(const judges_samples* piece, int64_t at, int64_t sample) {
  while (at + 1 < piece->target_count && piece->since[at + 1] <= sample) ++at;
  return at;
}

/* From the target on that holds at the block's first sample. */
static void follow(double* out, int32_t joint, int64_t first, int64_t count, int64_t at,
                   const judges_samples* piece) {
  for (int64_t i = 0; i < count;) {
    at = target_at(piece, at, first + i);
    int64_t end = count;
    if (at + 1 < piece->target_count && piece->since[at + 1] < first + end)
      end = piece->since[at + 1] - first;
    const double target = piece->targets[at * piece->joints + joint];
    for (; i < end; ++i) out[i] = target;
  }
}

/* Fill a row from what is measured, or let `at` point there. */
static void fill_input(const judges* all, int32_t row, const judges_samples* piece, int64_t from,
                       int64_t count) {
  const judges_input* what = &all->inputs[all->rows[row].left];
  double* out = all->values + (int64_t)row * FORMULA_BLOCK;
  const int64_t first = all->taken + from;
  all->at[row] = out;
  switch (what->kind) {
    case JUDGES_SAMPLE: {
      const double* samples = piece->rows + what->place * piece->stride + from;
      if (from + FORMULA_BLOCK <= piece->stride)
        all->at[row] = samples, fetch(samples + FORMULA_BLOCK);
      else
        memcpy(out, samples, (size_t)count * sizeof *out);
      break;
    }
    case JUDGES_TARGET:
      follow(out, what->place, first, count, all->target, piece);
      break;
    default:
      for (int64_t i = 0; i < count; ++i) out[i] = (double)(first + i);
  }
}

/* Whole blocks, whose length the compiler knows; values past the end are not read. */
static void fill(const judges* all, int32_t row, const judges_samples* piece, int64_t from,
                 int64_t count) {
  const formula_row* what = &all->rows[row];
  double* out = all->values + (int64_t)row * FORMULA_BLOCK;
  if (what->kind == FORMULA_INPUT) {
    fill_input(all, row, piece, from, count);
    return;
  }
  all->at[row] = out;
  if (what->kind == FORMULA_CONSTANT) {
    if (all->taken + from == 0) formula_compute(what, out, out, out, FORMULA_BLOCK);
    return;
  }
  formula_compute(what, out, all->at[what->left], all->at[what->right], FORMULA_BLOCK);
}

/* The largest or smallest of `found` and some values: several at a time, as each waits for the one
 * before it. */
enum { AT_A_TIME = 8 };
static double extreme(double found, const double* values, int64_t count, int largest) {
  double each[AT_A_TIME];
  int64_t i = 0;
  for (int k = 0; k < AT_A_TIME; ++k) each[k] = found;
  if (largest) {
    for (; i + AT_A_TIME <= count; i += AT_A_TIME)
      for (int k = 0; k < AT_A_TIME; ++k) each[k] = larger(values[i + k], each[k]);
  } else {
    for (; i + AT_A_TIME <= count; i += AT_A_TIME)
      for (int k = 0; k < AT_A_TIME; ++k) each[k] = smaller(values[i + k], each[k]);
  }
  for (; i < count; ++i)
    each[0] = largest ? larger(values[i], each[0]) : smaller(values[i], each[0]);
  for (int k = 1; k < AT_A_TIME; ++k)
    each[0] = largest ? larger(each[k], each[0]) : smaller(each[k], each[0]);
  return each[0];
}

static void reduce(judges_measure* one, const double* values, int64_t count) {
  double found = one->found;
  switch (one->reduction) {
    case JUDGES_MAX:
    case JUDGES_MIN:
      found = extreme(found, values, count, one->reduction == JUDGES_MAX);
      break;
    case JUDGES_MEAN:
      for (int64_t i = 0; i < count; ++i) found += values[i];
      break;
    case JUDGES_RMS:
      for (int64_t i = 0; i < count; ++i) found += values[i] * values[i];
      break;
    default:
      found = values[count - 1];
  }
  one->found = found;
}

static void begin_run(judges* all) {
  for (int32_t k = 0; k < all->requirement_count; ++k) (void)robustness_end(all->requirements[k]);
  for (int32_t k = 0; k < all->measure_count; ++k) {
    judges_measure* one = &all->measures[k];
    const int extreme = one->reduction == JUDGES_MAX || one->reduction == JUDGES_MIN;
    one->found = extreme ? (one->reduction == JUDGES_MAX ? -INFINITY : INFINITY) : 0.0;
  }
  all->taken = all->target = 0;
}

void judges_begin(judges* all, int32_t runs) {
  for (int32_t run = 0; run < runs; ++run) begin_run(&all[run]);
}

static int add_samples_of_piece(judges* all, const judges_samples* piece) {
  for (int64_t from = 0; from < piece->count; from += FORMULA_BLOCK) {
    const int64_t left = piece->count - from;
    const int64_t count = left < FORMULA_BLOCK ? left : FORMULA_BLOCK;
    all->target = target_at(piece, all->target, all->taken + from);
    for (int32_t k = 0; k < all->row_count; ++k) fill(all, k, piece, from, count);
    for (int32_t k = 0; k < all->requirement_count; ++k) {
      if (robustness_feed(all->requirements[k], all->at, count)) return -1;
    }
    for (int32_t k = 0; k < all->measure_count; ++k) {
      reduce(&all->measures[k], all->at[all->measures[k].row], count);
    }
    for (int32_t k = 0; k < all->kept_count; ++k) {
      memcpy(all->kept + k * all->kept_stride + from, all->at[all->kept_rows[k]],
             (size_t)count * sizeof(double));
    }
  }
  all->taken += piece->count;
  return 0;
}

int judges_add_samples(judges* all, int32_t runs, const judges_samples* pieces) {
  for (int32_t run = 0; run < runs; ++run)
    if (add_samples_of_piece(&all[run], &pieces[run])) return -1;
  return 0;
}

static void end_run(judges* all, double* robustness, double* measures) {
  for (int32_t k = 0; k < all->requirement_count; ++k) {
    robustness[k] = robustness_end(all->requirements[k]);
  }
  for (int32_t k = 0; k < all->measure_count; ++k) {
    const judges_measure* one = &all->measures[k];
    const int sums = one->reduction == JUDGES_MEAN || one->reduction == JUDGES_RMS;
    const double value = sums ? one->found / (double)all->taken : one->found;
    measures[k] = one->reduction == JUDGES_RMS ? sqrt(value) : value;
  }
}

void judges_end(judges* all, int32_t runs, double* robustness, double* measures) {
  for (int32_t run = 0; run < runs; ++run)
    end_run(&all[run], robustness + run * all->requirement_count,
            measures + run * all->measure_count);
}
