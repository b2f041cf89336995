#include "formula.h"

#include <float.h>
#include <math.h>

/* The truth value of what holds by a margin of 0; see formula.h. */
#define FORMULA_LEAST DBL_MIN

/* The operands are in either order the same, where one is not a number too. */
static double least_of(double a, double b) { return a < b || isnan(a) ? a : b; }
static double largest_of(double a, double b) { return a > b || isnan(a) ? a : b; }
static double least_truth(double a, double b) { return a < b ? a : b; }
static double largest_truth(double a, double b) { return a > b ? a : b; }

/* Whether a > b and by how much, where they are equal `equal`. */
static double compare(double a, double b, double equal) {
  const double margin = a - b;
  const double above = margin > FORMULA_LEAST ? margin : FORMULA_LEAST;
  const double below = margin < -FORMULA_LEAST ? margin : -FORMULA_LEAST;
  return a > b ? above : a < b ? below : a == b ? equal : 0.0;
}

#define EACH for (int64_t i = 0; i < count; ++i)

static inline void compute(const formula_row* row, double* restrict out, const double* a,
                           const double* b, const int64_t count) {
  switch (row->kind) {
    case FORMULA_CONSTANT:
      EACH out[i] = row->value;
      break;
    case FORMULA_ADD:
      EACH out[i] = a[i] + b[i];
      break;
    case FORMULA_SUBTRACT:
      EACH out[i] = a[i] - b[i];
      break;
    case FORMULA_MULTIPLY:
      EACH out[i] = a[i] * b[i];
      break;
    case FORMULA_DIVIDE:
      EACH out[i] = b[i] != 0.0 ? a[i] / b[i] : NAN;
      break;
    case FORMULA_LEAST_OF:
      EACH out[i] = least_of(a[i], b[i]);
      break;
    case FORMULA_LARGEST_OF:
      EACH out[i] = largest_of(a[i], b[i]);
      break;
    case FORMULA_ABS:
      EACH out[i] = fabs(a[i]);
      break;
    case FORMULA_SQRT:
      EACH out[i] = sqrt(a[i]);
      break;
    case FORMULA_AT_LEAST:
      EACH out[i] = compare(a[i], b[i], FORMULA_LEAST);
      break;
    case FORMULA_ABOVE:
      EACH out[i] = compare(a[i], b[i], -FORMULA_LEAST);
      break;
    case FORMULA_AND:
      EACH out[i] = least_truth(a[i], b[i]);
      break;
    case FORMULA_OR:
      EACH out[i] = largest_truth(a[i], b[i]);
      break;
    case FORMULA_NOT:
      EACH out[i] = -a[i];
      break;
    default:
      EACH out[i] = NAN;
  }
}

void formula_compute(const formula_row* row, double* out, const double* left, const double* right,
                     int64_t count) {
  if (!row || !out || !left || !right) return;
  if (count == FORMULA_BLOCK) {
    compute(row, out, left, right, FORMULA_BLOCK); /* the compiler knows its length */
  } else {
    compute(row, out, left, right, count);
  }
}

double formula_margin(double truth) {
  if (truth == 0.0) return NAN;
  return truth == FORMULA_LEAST ? 0.0 : truth;
}
