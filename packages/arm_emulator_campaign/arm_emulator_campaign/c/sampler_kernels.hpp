// The samples of arms on a device, behind the kernels of their fleet.
#pragma once

#include "sampler.c"

namespace {

// As sampler_record_group, for a group of arms.
void sample_group(void* with, std::int32_t first, std::int32_t arms) {
  auto* self = static_cast<sampler*>(with);
  self->fleet->observe(first / arm_fleet::lanes, self->measurements, self->truths);
  keep(self, first, arms);
}

}  // namespace

ARM_ADDRESS(sampler_observe, sample_group)
