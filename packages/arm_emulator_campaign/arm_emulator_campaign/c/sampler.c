#include "sampler.h"

#include <stddef.h>

static inline double number_at(const char* place, int32_t kind) {
  double real;
  int64_t integer;
  uint32_t small;
  switch (kind) {
    case SAMPLER_INT64:
      __builtin_memcpy(&integer, place, sizeof integer);
      return (double)integer;
    case SAMPLER_UINT32:
      __builtin_memcpy(&small, place, sizeof small);
      return (double)small;
    default:
      __builtin_memcpy(&real, place, sizeof real);
      return real;
  }
}

/* Keep what the core has written of these machines. */
static void keep(sampler* self, int32_t first, int32_t arms) {
  for (int32_t k = 0; k < self->count; ++k) {
    const sampler_number* of = &self->numbers[k];
    const char* place = of->place + first * of->stride;
    double* row = self->samples + ((int64_t)first * self->rows + of->row) * self->room;
    const int64_t* taken = self->taken + first;
    const int64_t next = self->rows * self->room; /* from a machine's row to the next one's */
    for (int32_t arm = 0; arm < arms; ++arm, place += of->stride, row += next)
      if (taken[arm] < self->room) row[taken[arm]] = number_at(place, of->kind);
  }
  for (int32_t arm = first; arm < first + arms; ++arm)
    if (self->taken[arm] < self->room) ++self->taken[arm];
}

void sampler_record(void* with, const arm_machine* machine) {
  sampler* self = (sampler*)with;
  if (self->measure) self->measure(machine, self->measurement);
  self->get_truth(machine, self->truth);
  keep(self, 0, 1);
}

void sampler_record_group(void* with, int32_t first, int32_t arms) {
  sampler* self = (sampler*)with;
  self->show(self->fleet, first, arms, NULL, 0, self->measurements, self->truths);
  keep(self, first, arms);
}
