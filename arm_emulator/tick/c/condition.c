#include "condition.h"

#include <string.h>

static double number(const condition* one, const condition_input* input, const double* p_WT) {
  const char* at = one->record + input->offset;
  switch (input->kind) {
    case CONDITION_DOUBLE: {
      double value;
      memcpy(&value, at, sizeof value);
      return value;
    }
    case CONDITION_INT64: {
      int64_t value;
      memcpy(&value, at, sizeof value);
      return (double)value;
    }
    case CONDITION_UINT32: {
      uint32_t value;
      memcpy(&value, at, sizeof value);
      return value;
    }
    default:
      return p_WT[input->offset];
  }
}

int condition_holds(condition* one, const arm_machine* machine) {
  if (!one || !machine || one->rows < 1 || !one->row || !one->values) return 0;
  one->measure(machine, one->measurement);
  one->get_truth(machine, one->truth);
  one->head->time = one->truth->time;
  one->head->tick = one->measurement->tick;
  double p_WT[3] = {0.0, 0.0, 0.0};
  if (one->tool)
    tool_positions(one->tool, (const double*)(const void*)(one->record + one->q), 1, 1, p_WT);
  for (int32_t k = 0; k < one->rows; ++k) {
    const formula_row* row = one->row + k;
    double* out = one->values + k;
    if (row->kind == FORMULA_INPUT) {
      *out = number(one, one->input + row->left, p_WT);
    } else {
      formula_compute(row, out, one->values + row->left, one->values + row->right, 1);
    }
  }
  return one->values[one->rows - 1] > 0.0;
}

void breakpoint_take(void* with, const arm_machine* machine) {
  breakpoint* one = with;
  if (!one || !one->what || !machine) return;
  const int holds = condition_holds(one->what, machine);
  if (holds && !one->held) {
    one->tick = one->what->measurement->tick;
    __atomic_store_n(&one->hit, 1, __ATOMIC_RELEASE);
  }
  one->held = holds;
}
