// The functions of equations.h for one scene. Included last in a unit after its `struct Scene`.
#pragma once

#include "boundary/equation_point.hpp"
#include "boundary/equations.h"
#include "mechanics/command_bounds.hpp"
#include "mechanics/linearisation.hpp"
#include "mechanics/torque_terms.hpp"
#include "schemes/linear_drive.hpp"

#pragma GCC visibility push(default)

ARM_ONCE std::int32_t arm_linear_drives(const double* point, std::int32_t loaded, double* out) {
  constexpr int K = arm::max_states<Scene>();
  if (!out) return K;
  if (!point) return 0;
  const arm::EquationPoint<Scene> at(point);
  const auto copy = [&](const double* from, int count) {
    for (int k = 0; k < count; ++k) *out++ = from[k];
  };
  at.numbers.for_each_drive([&](const auto& drive, int) {
    const auto linear = arm::LinearDrive<K, arm::max_modes<Scene>()>::linearise(
        drive, loaded ? drive.active_under_load : 0);
    *out++ = drive.states;
    *out++ = drive.carried();
    copy(linear.D, K);
    for (int k = 0; k < K; ++k) copy(linear.F[k], K + 3);
    copy(linear.G, K + 3);
    using Drive = std::remove_cvref_t<decltype(drive)>;
    for (int column = 0; column < K + 3; ++column) {
      typename Drive::template Input<double> one = {};
      linear.template set_input<Drive>(one, column, 1.0);
      out[column] = drive.current(one), out[K + 3 + column] = drive.motor_angle(one);
    }
    out += 2 * (K + 3);
  });
  return K;
}

ARM_ONCE void arm_linearise(const double* point, double* x, double* command, std::int32_t as_it_is,
                            std::int32_t slides, std::int32_t follows, double* out) {
  using Linear = arm::Linearisation<Scene>;
  if (!point || !x || !command || !out) return;
  const arm::EquationPoint<Scene> start(point);
  const arm::Numbers<Scene>& numbers = start.numbers;
  arm::State<Scene> at = start.state;
  if (!as_it_is)
    for (int k = 0; k < Linear::numbers; ++k) Linear::number(at, k) = x[k];
  arm::bound_commands(numbers, at, command);
  arm::set_algebraic_states(numbers, at, command);
  if (follows) arm::set_start_states(numbers, at, command);
  for (int k = 0; k < Linear::numbers; ++k) x[k] = Linear::number(at, k);
  const Linear linear(numbers, at, command, slides);
  linear.write(at, command, out);
  linear.write_structure(out + Linear::rows * (Linear::numbers + Scene::N + 1));
}

namespace {

// body(row, its links' part at q and v) for rows of joints.
void for_each_links(const double* point, std::int64_t count, const double* q, const double* v,
                    auto&& body) {
  const arm::EquationPoint<Scene> at(point);
  for (std::int64_t row = 0; row < count; ++row, q += Scene::N, v += Scene::N) {
    arm::Links<Scene>::Dynamics links;
    arm::Links<Scene>::compute_dynamics_apart(at.numbers, q, v, links);
    body(row, links);
  }
}

}  // namespace

void arm_forward_dynamics(const double* point, std::int64_t count, const double* q, const double* v,
                          const double* tau, double* a) {
  constexpr int N = Scene::N;
  if (!point || !q || !v || !tau || !a) return;
  for_each_links(point, count, q, v, [&](std::int64_t row, auto& links) {
    double x[N];
    for (int j = 0; j < N; ++j) x[j] = tau[row * N + j] - links.nle[j];
    arm::MassFactors<Scene> factors;
    factors.factor(links.M.at);
    factors.solve(x);
    for (int j = 0; j < N; ++j) a[row * N + j] = x[j];
  });
}

void arm_inverse_dynamics(const double* point, std::int64_t count, const double* q, const double* v,
                          const double* a, double* tau) {
  constexpr int N = Scene::N;
  if (!point || !q || !v || !a || !tau) return;
  for_each_links(point, count, q, v, [&](std::int64_t row, const auto& links) {
    for (int i = 0; i < N; ++i) {
      double sum = links.nle[i];
      for (int j = 0; j < N; ++j) sum += links.M.entry(i, j) * a[row * N + j];
      tau[row * N + i] = sum;
    }
  });
}

void arm_link_dynamics(const double* point, std::int64_t count, const double* q, const double* v,
                       double* M, double* nle) {
  constexpr int N = Scene::N;
  if (!point || !q || !v || !M || !nle) return;
  for_each_links(point, count, q, v, [&](std::int64_t, const auto& links) {
    for (int i = 0; i < N; ++i) {
      *nle++ = links.nle[i];
      for (int j = 0; j < N; ++j) *M++ = links.M.entry(i, j);
    }
  });
}

std::int32_t arm_torque_terms(const double* point, const double* command, double* out) {
  using Terms = arm::TorqueTerms<Scene>;
  if (!point || !command || !out) return Terms::rows;
  const arm::EquationPoint<Scene> at(point);
  double within[Scene::N];
  for (int j = 0; j < Scene::N; ++j) within[j] = command[j];
  arm::bound_commands(at.numbers, at.state, within);
  Terms::write(at.numbers, at.state, within, out);
  return Terms::rows;
}

#pragma GCC visibility pop
