// primal_calls.hpp of one scene, compiled beside sensitivity.hpp with ARM_RECORDS.
#pragma once

#include <cstddef>

#include "boundary/primal_calls.hpp"
#include "boundary/sensitivity.h"
#include "machine/machine.hpp"

struct arm_primal {
  arm::Machine<Scene> machine;
  arm::StepSegments<Scene::N, arm::State<Scene>::K> pieces;

  explicit arm_primal(const arm_sensitive_run* run) : machine(run->step, -1, run->parameters) {
    using Drives = arm::DriveRow<Scene, double>;
    machine.reset(Drives(run->q).of, Drives(run->v).of);
    if (run->theta_m && run->omega_m) {
      arm::State<Scene> at = machine.state();
      arm::set_motors(machine.numbers(), Drives(run->theta_m).of, Drives(run->omega_m).of, at);
      machine.set_state(at, true);
    }
    [this]<class Machine>(Machine& of) {
      if constexpr (Machine::locates) of.record_segments_in(&pieces);
    }(machine);
  }
};

arm_primal* arm_primal_new(const arm_sensitive_run* run) { return new arm_primal(run); }
void arm_primal_delete(arm_primal* primal) { delete primal; }
bool arm_primal_advance(arm_primal* primal, const double* command, int64_t steps) {
  primal->pieces.clear();
  if (primal->machine.advance(command, steps) >= 0) return false;
  auto& last = primal->pieces.emplace_back();
  const auto& x = primal->machine.state();
  for (int j = 0; j < Scene::N; ++j) {
    for (int k = 0; k < x.K; ++k) last.z[k][j] = x.z[k][j];
    last.q[j] = x.q[j], last.v[j] = x.v[j];
  }
  return true;
}
const void* arm_primal_pieces(const arm_primal* primal, int64_t* count) {
  *count = static_cast<int64_t>(primal->pieces.size()) - 1;
  return primal->pieces.data();
}
