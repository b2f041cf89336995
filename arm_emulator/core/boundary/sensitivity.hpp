// sensitivity.h of one scene, compiled with ARM_DIRECTIONS (numerics/real.hpp).
#pragma once

#include "boundary/sensitivity.h"
#include "machine/machine.hpp"

namespace {

using arm::Real;

// Numbers with the derivatives of their seeds.
template <int count>
struct Seeded {
  Real at[count > 0 ? count : 1] = {};

  Seeded(const double* values, const double* seeds) {
    for (int k = 0; k < count; ++k) {
      at[k] = values[k];
      for (int d = 0; d < ARM_DIRECTIONS; ++d) at[k].by[d] = *seeds++;
    }
  }
};

double* write(double* to, const Real* numbers) {
  for (int j = 0; j < Scene::N; ++j) {
    *to++ = numbers[j].value;
    for (int d = 0; d < ARM_DIRECTIONS; ++d) *to++ = numbers[j].by[d];
  }
  return to;
}

}  // namespace

#pragma GCC visibility push(default)

std::int32_t arm_directions() { return ARM_DIRECTIONS; }

std::int64_t arm_run_with_sensitivities(const arm_sensitive_run* run) {
  constexpr int N = Scene::N;
  const Seeded<Scene::parameters> numbers(run->parameters, run->parameter_seeds);
  arm::Machine<Scene> machine(run->step, -1, numbers.at);
  machine.reset(Seeded<N>(run->q, run->q_seeds).at, Seeded<N>(run->v, run->v_seeds).at);
  if (run->theta_m && run->omega_m) {
    arm::State<Scene> at = machine.state();
    machine.numbers_now().for_each_drive([&](const auto& drive, int j) {
      auto put = arm::input_of(drive, j, at, 0.0);
      drive.put_motor(put, 0.0, run->theta_m[j], run->omega_m[j]);
      arm::put_states(drive, j, 0, put, at);
    });
    machine.put(at, true);
  }
  const double* command = run->commands;
  double* out = run->out;
  for (std::int64_t row = 0; row < run->rows; ++row) {
    Real u[N], current[N], angle[N], speed[N];
    for (Real& one : u) one = *command++;
    if (machine.advance(u, run->steps) >= 0) return row;
    machine.report(current, angle, speed);
    for (const Real* one : {machine.state().q, machine.state().v}) out = write(out, one);
    for (const Real* one : {current, angle, speed}) out = write(out, one);
  }
  return run->rows;
}

#pragma GCC visibility pop
