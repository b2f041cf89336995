// The C face of one scene's machine, called from Python through ctypes (emulator_node/plant.py).
// Included last in a scene's unit, after its `struct Scene`.
#pragma once

#include <algorithm>
#include <cstdint>

#include "real_time.hpp"

using TheMachine = arm::Machine<Scene>;
using TheRealTime = arm::RealTime<Scene>;
using TheLinks = arm::Links<Scene>;
static constexpr int N = Scene::N;
#pragma GCC visibility push(default)
extern "C" {
TheMachine* arm_new(double dt, int core) { return new TheMachine(dt, core); }
void arm_delete(TheMachine* machine) { delete machine; }
void arm_reset(TheMachine* machine, const double* q, const double* v) { machine->reset(q, v); }
// Returns -1, the joint that went out of bounds, or -2 if a voltage is not finite.
int arm_advance(TheMachine* machine, const double* voltage, std::int64_t steps) {
  if (!std::all_of(voltage, voltage + N, arm::is_finite)) return -2;
  return machine->advance(voltage, steps);
}
// `rows` rows of N voltages, `steps` steps each; q after each row goes to `q`.
int arm_run(TheMachine* machine, const double* voltage, std::int64_t rows, std::int64_t steps,
            double* q) {
  return machine->follow(voltage, rows, steps, q);
}
double arm_time(const TheMachine* machine) { return machine->time(); }
double arm_energy(const TheMachine* machine) { return machine->energy(); }
// out: i, tm, wm, q, v, T, N values each
void arm_state(const TheMachine* machine, double* out) {
  const auto& x = machine->state();
  machine->report(out, out + N, out + 2 * N);
  std::copy_n(x.q, N, out + 3 * N);
  std::copy_n(x.v, N, out + 4 * N);
  machine->gear_torques(out + 5 * N);
}

// The linear part of every drive (drive_table.hpp), for the analysis of small motions. Rows of K
// states; returns K. out, per joint: how many states it has, the carried rotor, D (K), F (K rows of
// K + 4) and G (K + 4); the columns are z, q, v, u and side. With `out` null only K is returned.
int arm_linear_drives(double* out) {
  constexpr int K = arm::most_states<Scene>();
  if (!out) return K;
  arm::for_each_drive<Scene>([&](const auto& drive, int) {
    const auto linear = arm::LinearDrive<K>::of(drive, false);
    *out++ = drive.states;
    *out++ = drive.carried();
    out = std::copy_n(linear.D, K, out);
    for (int k = 0; k < K; ++k) out = std::copy_n(linear.F[k], K + 4, out);
    out = std::copy_n(linear.G, K + 4, out);
  });
  return K;
}

// Real time. The machine must outlive it.
TheRealTime* arm_real_time_new(TheMachine* machine, std::int64_t period, std::int64_t steps,
                               int core) {
  return new TheRealTime(*machine, period, steps, core);
}
void arm_real_time_delete(TheRealTime* loop) { delete loop; }
void arm_real_time_start(TheRealTime* loop, std::int64_t tick) { loop->start(tick); }
void arm_real_time_stop(TheRealTime* loop) { loop->stop(); }
void arm_real_time_command(TheRealTime* loop, std::int64_t answered, const double* voltage) {
  loop->command(answered, voltage);
}
void arm_real_time_power(TheRealTime* loop, int on) { loop->power(on != 0); }
int arm_real_time_take(TheRealTime* loop, arm::Snapshot<N>* out) { return loop->take(*out); }
int arm_real_time_descriptor(const TheRealTime* loop) { return loop->descriptor(); }
void arm_real_time_status(const TheRealTime* loop, TheRealTime::Status* out) {
  *out = loop->status();
}
void arm_real_time_clear_figures(TheRealTime* loop) { loop->clear_figures(); }

// The links alone, for `count` rows of N: M(q) a + nle(q, v) = tau.
void arm_forward_dynamics(std::int64_t count, const double* q, const double* v, const double* tau,
                          double* a) {
  for (std::int64_t row = 0; row < count; ++row, q += N, v += N, tau += N, a += N) {
    double q_row[N], v_row[N], x[N];
    std::copy_n(q, N, q_row);
    std::copy_n(v, N, v_row);
    TheLinks::Kinematics k;
    TheLinks::MassMatrix M;
    TheLinks::kinematics(q_row, k);
    TheLinks::inverse_dynamics(k, v_row, nullptr, x);
    TheLinks::mass_matrix(k, M);
    for (int j = 0; j < N; ++j) x[j] = tau[j] - x[j];
    arm::Cholesky<N> factors;
    factors.factor(M.at);
    factors.solve(x);
    std::copy_n(x, N, a);
  }
}
}
#pragma GCC visibility pop
