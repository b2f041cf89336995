/* Formulas at an instant, for conditions, breakpoints and campaigns: rows, each computed from rows
 * before it, a number for each instant of a block. C99.
 *
 * Numbers are doubles of IEEE 754, rounded after each operation: what is too large is infinite. A
 * quotient by 0 is not a number, since the sign of infinity would depend on the sign of 0. Nor are
 * the square root of a negative number, inf - inf, 0 * inf, inf / inf, and values computed from
 * them: minima and maxima too, in any order of their arguments.
 *
 * Truth values are doubles, too: the margin of a comparison, more - less, where it holds (> 0) and
 * where it fails (< 0). 0 is neither: a comparison with what is not a number is undefined, and so
 * is its negation. By a margin of 0, two equal infinities included, `<=` and `>=` hold by
 * FORMULA_LEAST, and `<` and `>` fail by it. So `and` is the minimum, `or` the maximum and `not`
 * the negation: where a part is undefined, the others decide if they can (Kleene's logic). */
#ifndef FORMULA_H
#define FORMULA_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

enum formula_kind {
  FORMULA_CONSTANT, /* `value` */
  FORMULA_INPUT,    /* number `left` of what the caller measures, who fills this row */
  FORMULA_ADD,      /* of rows `left` and `right`, as all that follow */
  FORMULA_SUBTRACT,
  FORMULA_MULTIPLY,
  FORMULA_DIVIDE,
  FORMULA_LEAST_OF,
  FORMULA_LARGEST_OF,
  FORMULA_ABS, /* of row `left`, as the next one */
  FORMULA_SQRT,
  FORMULA_AT_LEAST, /* the truth value of left >= right */
  FORMULA_ABOVE,    /* of left > right */
  FORMULA_AND,      /* of truth values, as the next ones */
  FORMULA_OR,
  FORMULA_NOT /* of row `left` */
};

/* Instants in a block: the blocks of all rows of a formula are in the processor's nearest cache. */
enum { FORMULA_BLOCK = 72 };

typedef struct formula_row {
  int32_t kind;
  int32_t left;
  int32_t right;
  int32_t reserved;
  double value;
} formula_row;

/* Compute a row that is no input at so many instants, at most FORMULA_BLOCK, from its operands. */
void formula_compute(const formula_row* row, double* out, const double* left, const double* right,
                     int64_t count);
/* The margin of a truth value: 0 where it holds by nothing, NaN where it is undefined. */
double formula_margin(double truth);

#ifdef __cplusplus
}
#endif

#endif
