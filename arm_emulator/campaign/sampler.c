#include "sampler.h"

#include <string.h>

static double number_at(const char* place, int32_t kind) {
  double real;
  int64_t whole;
  uint32_t small;
  switch (kind) {
    case SAMPLER_INT64:
      memcpy(&whole, place, sizeof whole);
      return (double)whole;
    case SAMPLER_UINT32:
      memcpy(&small, place, sizeof small);
      return (double)small;
    default:
      memcpy(&real, place, sizeof real);
      return real;
  }
}

void sampler_take(void* with, const arm_machine* machine) {
  sampler* one = with;
  if (one->taken >= one->room) return;
  if (one->measure) one->measure(machine, one->measurement);
  one->get_truth(machine, one->truth);
  for (int32_t k = 0; k < one->count; ++k) {
    const sampler_number* of = &one->numbers[k];
    one->samples[of->row * one->room + one->taken] = number_at(one->row + of->offset, of->kind);
  }
  ++one->taken;
}
