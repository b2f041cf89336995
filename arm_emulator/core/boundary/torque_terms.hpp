// arm_torque_terms: for a library of its own, as no run needs it.
#pragma once

#include "boundary/arm_machine.hpp"
#include "boundary/torque_terms.h"
#include "mechanics/torque_terms.hpp"

#pragma GCC visibility push(default)

std::int32_t arm_torque_terms(const arm_machine* machine, const double* command, double* out) {
  using Terms = arm::TorqueTerms<Scene>;
  if (!machine || !command || !out) return Terms::rows;
  const arm::Numbers<Scene>& numbers = machine->machine.numbers_now();
  const arm::State<Scene> at = machine->machine.state();
  double within[arm_machine::N];
  const double* powered = machine->with_power(command);
  for (int j = 0; j < arm_machine::N; ++j) within[j] = powered[j];
  arm::bound_commands(numbers, at, within);
  Terms::write(numbers, at, within, out);
  return Terms::rows;
}

#pragma GCC visibility pop
