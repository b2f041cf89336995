#include "sampler.h"

#include <stddef.h>

static inline double number_at(const char* place, int32_t kind) {
  double real;
  int64_t whole;
  uint32_t small;
  switch (kind) {
    case SAMPLER_INT64:
      __builtin_memcpy(&whole, place, sizeof whole);
      return (double)whole;
    case SAMPLER_UINT32:
      __builtin_memcpy(&small, place, sizeof small);
      return (double)small;
    default:
      __builtin_memcpy(&real, place, sizeof real);
      return real;
  }
}

/* Keep what the core has written of these machines. */
static void keep(sampler* one, int32_t first, int32_t arms) {
  for (int32_t k = 0; k < one->count; ++k) {
    const sampler_number* of = &one->numbers[k];
    const char* place = of->place + first * of->stride;
    double* row = one->samples + ((int64_t)first * one->rows + of->row) * one->room;
    const int64_t* taken = one->taken + first;
    const int64_t next = one->rows * one->room; /* from a machine's row to the next one's */
    for (int32_t arm = 0; arm < arms; ++arm, place += of->stride, row += next)
      if (taken[arm] < one->room) row[taken[arm]] = number_at(place, of->kind);
  }
  for (int32_t arm = first; arm < first + arms; ++arm)
    if (one->taken[arm] < one->room) ++one->taken[arm];
}

void sampler_take(void* with, const arm_machine* machine) {
  sampler* one = (sampler*)with;
  if (one->measure) one->measure(machine, one->measurement);
  one->get_truth(machine, one->truth);
  keep(one, 0, 1);
}

void sampler_take_abreast(void* with, int32_t first, int32_t arms) {
  sampler* one = (sampler*)with;
  one->show(one->fleet, first, arms, NULL, 0, one->measurements, one->truths);
  keep(one, first, arms);
}
