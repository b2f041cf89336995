// sensitivity.h of one scene, compiled with ARM_DIRECTIONS (numerics/real.hpp).
#pragma once

#include <memory>
#include <vector>

#include "boundary/primal_calls.hpp"
#include "boundary/sensitivity.h"
#include "machine/machine.hpp"
#include "schemes/derivative_replay.hpp"

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

// A part of the directions, to begin with.
struct Begin {
  using Numbers = arm::Numbers<Scene>;
  Seeded<Scene::parameters> parameters;
  static constexpr int J = arm::count_joints<Scene>();
  Seeded<J> q, v;

  Begin(const arm_sensitive_run& run, std::int64_t part)
      : parameters(run.parameters, run.parameter_seeds + part * Scene::parameters * ARM_DIRECTIONS),
        q(run.q, run.q_seeds + part * J * ARM_DIRECTIONS),
        v(run.v, run.v_seeds + part * J * ARM_DIRECTIONS) {}

  arm::State<Scene> state(const arm_sensitive_run& run) const {
    const Numbers numbers(parameters.at);
    using Drives = arm::DriveRow<Scene, Real>;
    auto x = arm::make_rest_state(numbers, Drives(q.at).of, Drives(v.at).of);
    using Motors = arm::DriveRow<Scene, double>;
    if (run.theta_m && run.omega_m)
      arm::set_motors(numbers, Motors(run.theta_m).of, Motors(run.omega_m).of, x);
    return x;
  }
};

// Put down a part's derivatives at the end of a row, and the values.
void write_row(const arm_sensitive_run& run, std::int64_t part, std::int64_t row,
               const arm::Numbers<Scene>& numbers, const arm::State<Scene>& x) {
  constexpr int N = arm::count_joints<Scene>();
  Real of[5][N];
  numbers.for_each_drive([&](const auto& drive, int number) {
    const int j = arm::find_joint<Scene>(number);
    if (arm::drive_of<Scene>(j) != number) return;
    const auto at = arm::input_of(drive, number, x, 0.0);
    of[0][j] = x.q[number], of[1][j] = x.v[number];
    of[2][j] = drive.current(at);
    of[3][j] = drive.motor_angle(at);
    of[4][j] = drive.motor_speed(at);
  });
  double* value = run.values + row * 5 * N;
  double* slope = run.slopes + row * 5 * N * run.stride + part * ARM_DIRECTIONS;
  for (const auto& quantity : of)
    for (const Real& number : quantity) {
      *value++ = number.value;
      for (int d = 0; d < ARM_DIRECTIONS; ++d) slope[d] = number.by[d];
      slope += run.stride;
    }
}

// Machines that decide for themselves.
template <class S>
std::int64_t run_single(const arm_sensitive_run& run, std::int64_t part) {
  const Begin begin(run, part);
  arm::Machine<S> machine(run.step, -1, begin.parameters.at);
  machine.set_state(begin.state(run), true);
  for (std::int64_t row = 0; row < run.rows; ++row) {
    const arm::DriveRow<Scene, double> command(run.commands + row * arm::count_joints<Scene>());
    Real u[Scene::N];
    for (int j = 0; j < Scene::N; ++j) u[j] = command.of[j];
    if (machine.advance(u, run.steps) >= 0) return row;
    write_row(run, part, row, machine.numbers(), machine.state());
  }
  return run.rows;
}

// Machines that follow one whose values decide.
template <class S>
std::int64_t run_replays(const arm_sensitive_run& run) {
  using DerivativeReplay = arm::DerivativeReplay<S>;
  const std::unique_ptr<arm_primal, void (*)(arm_primal*)> primal(arm_primal_new(&run),
                                                                  arm_primal_delete);
  std::vector<std::unique_ptr<DerivativeReplay>> followers;
  for (std::int64_t part = 0; part < run.parts; ++part) {
    const Begin begin(run, part);
    followers.push_back(
        std::make_unique<DerivativeReplay>(run.step, begin.parameters.at, begin.state(run)));
  }
  const std::vector<Real> parameters(run.parameters, run.parameters + S::parameters);
  typename DerivativeReplay::Values values(run.step, parameters.data(), run.parts == 1);
  std::vector<typename DerivativeReplay::Common> common;
  for (std::int64_t row = 0; row < run.rows; ++row) {
    const arm::DriveRow<Scene, double> drives(run.commands + row * arm::count_joints<Scene>());
    const double* command = drives.of;
    if (!arm_primal_advance(primal.get(), command, run.steps)) return row;
    std::int64_t count;
    const auto* pieces = static_cast<const typename DerivativeReplay::Piece*>(
        arm_primal_pieces(primal.get(), &count));
    common.resize(count);
    for (auto& of_piece : common) of_piece.begun = false;
    for (std::int64_t part = 0; part < run.parts; ++part) {
      DerivativeReplay& replay = *followers[part];
      replay.begin_row(command);
      for (std::int64_t k = 0; k < count; ++k)
        replay.replay_part(pieces[k], pieces[k + 1], values, common[k]);
      replay.finish_row(pieces[count]);
      write_row(run, part, row, replay.numbers(), replay.state());
    }
  }
  return run.rows;
}

template <class S>
std::int64_t run_all(const arm_sensitive_run& run) {
  if constexpr (arm::Machine<S>::locates) {
    return run_replays<S>(run);
  } else {
    std::int64_t done = run.rows;
    for (std::int64_t part = 0; part < run.parts && done == run.rows; ++part)
      done = run_single<S>(run, part);
    return done;
  }
}

}  // namespace

#pragma GCC visibility push(default)

std::int32_t arm_directions() { return ARM_DIRECTIONS; }

std::int64_t arm_run_with_sensitivities(const arm_sensitive_run* run) {
  return run_all<Scene>(*run);
}

#pragma GCC visibility pop
