/* A formula about a machine behind arm.h, as the machine is now, and breakpoints on it. C99. */
#ifndef CONDITION_H
#define CONDITION_H

#include "arm.h"
#include "formula.h"
#include "record_ring.h"
#include "tool_position.h"

#ifdef __cplusplus
extern "C" {
#endif

enum condition_input_kind {
  CONDITION_DOUBLE, /* of the row, at `offset` */
  CONDITION_INT64,
  CONDITION_UINT32,
  CONDITION_TOOL /* position in the world [m], axis `offset` */
};

typedef struct condition_input {
  int32_t kind;
  int32_t reserved;
  int64_t offset; /* bytes */
} condition_input;

typedef struct condition {
  uint32_t size;
  int32_t rows; /* of the formula, the last of which is its truth value; 0: it never holds */
  const formula_row* row;
  const condition_input* input; /* what FORMULA_INPUT numbers */
  double* values;               /* one for each row */
  int (*measure)(const arm_machine*, arm_measurement*);
  int (*get_truth)(const arm_machine*, arm_truth*);
  arm_measurement* measurement; /* these write into `record` */
  arm_truth* truth;
  const char* record;
  record_row* head;       /* of the record */
  const tool_chain* tool; /* null: no input needs it */
  int64_t q;              /* where the positions of drives begin in the record */
} condition;

/* Whether the condition holds for the machine as it is now: 1 or 0. */
int condition_holds(condition* self, const arm_machine* machine);

/* A condition that is evaluated at the end of each exchange: a breakpoint on physics. */
typedef struct breakpoint {
  uint32_t size;
  int32_t held; /* 1: it held at the newest tick */
  int32_t hit;  /* 1: it began to hold. Loops stop there; the owner clears it */
  int32_t reserved;
  condition* what;
  int64_t tick; /* where it began to hold last */
} breakpoint;

/* Look at the machine; a listener of arm_listen, `with` being the breakpoint. */
void breakpoint_take(void* with, const arm_machine* machine);

#ifdef __cplusplus
}
#endif

#endif
