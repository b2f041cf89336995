// The functions of arm.h that report a machine's equations: powers, linear forms, link dynamics.
#pragma once

#include "boundary/arm_machine.hpp"
#include "mechanics/linearisation.hpp"

#pragma GCC visibility push(default)

namespace {

[[maybe_unused]] void write_flow(const arm::EnergyFlow<Scene>& flow, double* out) {
  for (int j = 0; j < arm_machine::N; ++j) {
    out[j] = flow.given[j];
    out[arm_machine::N + j] = flow.dissipated[j];
  }
}

[[maybe_unused]] int refuse_flow(const arm_machine* machine) {
  if (!machine) return ARM_REFUSED;
  return machine->refuse(-1, "energy_flow", "be true in the scene", 0.0);
}

}  // namespace

int arm_powers(const arm_machine* machine, const double* command, double* out) {
  if constexpr (!Scene::energy_flow) {
    return refuse_flow(machine);
  } else {
    if (!machine || machine->check_finite(command, "command") || machine->check_there(out, "out"))
      return ARM_REFUSED;
    write_flow(machine->machine.powers(machine->with_power(command)), out);
    return ARM_OK;
  }
}

int arm_advance_metered(arm_machine* machine, const double* command, std::int64_t steps,
                        double* out) {
  if constexpr (!Scene::energy_flow) {
    return refuse_flow(machine);
  } else {
    if (!machine || machine->check_finite(command, "command") || machine->check_there(out, "out") ||
        machine->check_count(steps, "steps"))
      return ARM_REFUSED;
    arm::EnergyFlow<Scene> flow;
    const double* given = machine->with_power(command);
    machine->go(steps,
                [&](std::int64_t some) { machine->machine.advance_metered(given, some, flow); });
    write_flow(flow, out);
    return machine->result();
  }
}

ARM_ONCE int arm_linear_drives(const arm_machine* machine, std::int32_t loaded, double* out) {
  constexpr int K = arm::most_states<Scene>();
  if (!out) return K;
  if (!machine) return 0;
  const auto copy = [&](const double* from, int count) {
    for (int k = 0; k < count; ++k) *out++ = from[k];
  };
  machine->machine.numbers_now().for_each_drive([&](const auto& drive, int) {
    const auto linear = arm::LinearDrive<K, arm::most_modes<Scene>()>::of(
        drive, loaded ? drive.held_under_load : 0);
    *out++ = drive.states;
    *out++ = drive.carried();
    copy(linear.D, K);
    for (int k = 0; k < K; ++k) copy(linear.F[k], K + 3);
    copy(linear.G, K + 3);
    using Drive = std::remove_cvref_t<decltype(drive)>;
    for (int column = 0; column < K + 3; ++column) {
      typename Drive::template Input<double> one = {};
      linear.template set<Drive>(one, column, 1.0);
      out[column] = drive.current(one), out[K + 3 + column] = drive.motor_angle(one);
    }
    out += 2 * (K + 3);
  });
  return K;
}

ARM_ONCE int arm_linearise(const arm_machine* machine, double* x, double* command,
                           std::int32_t as_it_is, std::int32_t slides, double* out) {
  using Linear = arm::Linearisation<Scene>;
  if (!machine || machine->check_there(x, "x") || machine->check_finite(command, "command") ||
      machine->check_there(out, "out"))
    return ARM_REFUSED;
  const arm::Numbers<Scene>& numbers = machine->machine.numbers_now();
  arm::State<Scene> at = machine->machine.state();
  if (!as_it_is)
    for (int k = 0; k < Linear::numbers; ++k) Linear::number(at, k) = x[k];
  arm::bound_commands(numbers, at, command);
  arm::follow_at_once(numbers, at, command);
  for (int k = 0; k < Linear::numbers; ++k) x[k] = Linear::number(at, k);
  const Linear linear(numbers, at, command, slides);
  linear.write(at, command, out);
  linear.write_structure(out + Linear::rows * (Linear::numbers + arm_machine::N + 1));
  return ARM_OK;
}

void arm_forward_dynamics(const arm_machine* machine, std::int64_t count, const double* q,
                          const double* v, const double* tau, double* a) {
  constexpr int N = arm_machine::N;
  using Links = arm::Links<Scene>;
  if (!machine || !q || !v || !tau || !a) return;
  for (std::int64_t row = 0; row < count; ++row, q += N, v += N, tau += N, a += N) {
    Links::Dynamics links;
    double x[N];
    Links::dynamics_apart(machine->machine.numbers_now(), q, v, links);
    for (int j = 0; j < N; ++j) x[j] = tau[j] - links.nle[j];
    arm::MassFactors<Scene> factors;
    factors.factor(links.M.at);
    factors.solve(x);
    for (int j = 0; j < N; ++j) a[j] = x[j];
  }
}

void arm_inverse_dynamics(const arm_machine* machine, std::int64_t count, const double* q,
                          const double* v, const double* a, double* tau) {
  constexpr int N = arm_machine::N;
  using Links = arm::Links<Scene>;
  if (!machine || !q || !v || !a || !tau) return;
  for (std::int64_t row = 0; row < count; ++row, q += N, v += N, a += N, tau += N) {
    Links::Dynamics links;
    Links::dynamics_apart(machine->machine.numbers_now(), q, v, links);
    for (int i = 0; i < N; ++i) {
      tau[i] = links.nle[i];
      for (int j = 0; j < N; ++j) tau[i] += links.M.at[i < j ? i : j][i < j ? j : i] * a[j];
    }
  }
}

void arm_link_dynamics(const arm_machine* machine, std::int64_t count, const double* q,
                       const double* v, double* M, double* nle) {
  constexpr int N = arm_machine::N;
  using Links = arm::Links<Scene>;
  if (!machine || !q || !v || !M || !nle) return;
  for (std::int64_t row = 0; row < count; ++row, q += N, v += N, M += N * N, nle += N) {
    Links::Dynamics links;
    Links::dynamics_apart(machine->machine.numbers_now(), q, v, links);
    for (int i = 0; i < N; ++i) {
      nle[i] = links.nle[i];
      for (int j = 0; j < N; ++j) M[i * N + j] = links.M.at[i < j ? i : j][i < j ? j : i];
    }
  }
}

#pragma GCC visibility pop
