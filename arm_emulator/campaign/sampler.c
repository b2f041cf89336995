#include "sampler.h"

#include <stddef.h>
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

/* Keep what the core has written of these machines. */
static void keep(sampler* one, int32_t first, int32_t arms) {
  for (int32_t k = 0; k < one->count; ++k) {
    const sampler_number* of = &one->numbers[k];
    for (int32_t arm = first; arm < first + arms; ++arm) {
      const int64_t row = (int64_t)arm * one->rows + of->row, taken = one->taken[arm];
      if (taken < one->room)
        one->samples[row * one->room + taken] = number_at(of->place + arm * of->stride, of->kind);
    }
  }
  for (int32_t arm = first; arm < first + arms; ++arm)
    if (one->taken[arm] < one->room) ++one->taken[arm];
}

void sampler_take(void* with, const arm_machine* machine) {
  sampler* one = with;
  if (one->measure) one->measure(machine, one->measurement);
  one->get_truth(machine, one->truth);
  keep(one, 0, 1);
}

void sampler_take_abreast(void* with, int32_t first, int32_t arms) {
  sampler* one = with;
  one->show(one->fleet, first, arms, NULL, 0, one->measurements, one->truths);
  keep(one, first, arms);
}
