#include "condition.h"

#include <string.h>

static double number(const condition* self, const condition_input* input, const double* p_WT) {
  const char* at = self->record + input->offset;
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

int condition_holds(condition* self, const arm_machine* machine) {
  if (!self || !machine || self->rows < 1 || !self->row || !self->values) return 0;
  self->measure(machine, self->measurement);
  self->get_truth(machine, self->truth);
  self->head->time = self->truth->time;
  self->head->tick = self->measurement->tick;
  double p_WT[3] = {0.0, 0.0, 0.0};
  if (self->tool)
    tool_positions(self->tool, (const double*)(const void*)(self->record + self->q), 1, 1, p_WT);
  for (int32_t k = 0; k < self->rows; ++k) {
    const formula_row* row = self->row + k;
    double* out = self->values + k;
    if (row->kind == FORMULA_INPUT) {
      *out = number(self, self->input + row->left, p_WT);
    } else {
      formula_compute(row, out, self->values + row->left, self->values + row->right, 1);
    }
  }
  return self->values[self->rows - 1] > 0.0;
}

void breakpoint_take(void* with, const arm_machine* machine) {
  breakpoint* self = with;
  if (!self || !self->what || !machine) return;
  const int holds = condition_holds(self->what, machine);
  if (holds && !self->held) {
    self->tick = self->what->measurement->tick;
    __atomic_store_n(&self->hit, 1, __ATOMIC_RELEASE);
  }
  self->held = holds;
}
