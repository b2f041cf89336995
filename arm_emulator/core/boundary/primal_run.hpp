// primal_calls.hpp of one scene, compiled beside sensitivity.hpp with ARM_RECORDS.
#pragma once

#include <cstddef>

#include "boundary/primal_calls.hpp"
#include "boundary/sensitivity.h"
#include "machine/machine.hpp"

struct arm_leader {
  arm::Machine<Scene> machine;
  arm::StepSegments<Scene::N, arm::State<Scene>::K> pieces;

  explicit arm_leader(const arm_sensitive_run* run) : machine(run->step, -1, run->parameters) {
    machine.reset(run->q, run->v);
    if (run->theta_m && run->omega_m) {
      arm::State<Scene> at = machine.state();
      arm::put_motors(machine.numbers_now(), run->theta_m, run->omega_m, at);
      machine.put(at, true);
    }
    [this]<class Machine>(Machine& of) {
      if constexpr (Machine::locates) of.note_in(&pieces);
    }(machine);
  }
};

arm_leader* arm_leader_new(const arm_sensitive_run* run) { return new arm_leader(run); }
void arm_leader_delete(arm_leader* leader) { delete leader; }
bool arm_leader_advance(arm_leader* leader, const double* command, int64_t steps) {
  leader->pieces.clear();
  if (leader->machine.advance(command, steps) >= 0) return false;
  auto& last = leader->pieces.emplace_back();
  const auto& x = leader->machine.state();
  for (int j = 0; j < Scene::N; ++j) {
    for (int k = 0; k < x.K; ++k) last.z[k][j] = x.z[k][j];
    last.q[j] = x.q[j], last.v[j] = x.v[j];
  }
  return true;
}
const void* arm_leader_pieces(const arm_leader* leader, int64_t* count) {
  *count = static_cast<int64_t>(leader->pieces.size()) - 1;
  return leader->pieces.data();
}
