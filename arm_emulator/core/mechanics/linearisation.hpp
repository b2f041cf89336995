// Linearisation about a state: derivatives of D dz/dt and dv/dt by states and commands, with all
// modes held (modes.hpp): a sticking joint rests, a current stays at its limit, contact does not
// change.
//
// Central differences of order 4 of the equations themselves, with steps that are exact in binary
// and small against the nonlinearities: the speed of Stribeck's friction, a progressive gear's
// wind-up, an angle.
#pragma once

#include "mechanics/modes.hpp"

namespace arm {

template <class S>
class Linearisation {
 public:
  static constexpr int N = S::N, K = State<S>::K;
  // Numbers of a state: z by state and joint, q, v. Rows: D dz/dt, dv/dt, currents, motor angles.
  static constexpr int numbers = (K + 2) * N, rows = (K + 3) * N;

  // `slides`: no dry friction, whether joints rest or not.
  ARM_ONCE Linearisation(const Numbers<S>& numbers, const State<S>& x, const Real* u, bool slides)
      : n(numbers), modes(modes_at(x, u, slides)) {
    n.for_each_drive([&]<class Drive>(const Drive&, int) {
      if (Drive::has_gear_memory) step = 0x1p-23;
    });
  }

  // Write an entry of every row for each number of x and each command, and its own value.
  ARM_ONCE void write(State<S> x, const Real* u, Real* out) const {
    constexpr int columns = numbers + N + 1;
    Real command[N], value[rows];
    for (int j = 0; j < N; ++j) command[j] = u[j];
    rates(x, command, value);
    for (int row = 0; row < rows; ++row) out[row * columns + columns - 1] = value[row];
    for (int column = 0; column < columns - 1; ++column) {
      Real& at = column < numbers ? number(x, column) : command[column - numbers];
      const bool speed = column >= numbers - N && column < numbers;
      const Real middle = at, h = step_at(middle, speed ? 0x1p-14 : step);
      const Real factor[] = {1.0, -8.0, 8.0, -1.0}, place[] = {-2.0, -1.0, 1.0, 2.0};
      Real sum[rows] = {};
      for (int k = 0; k < 4; ++k) {
        at = middle + place[k] * h;
        rates(x, command, value);
        for (int row = 0; row < rows; ++row) sum[row] += factor[k] * value[row];
      }
      at = middle;
      for (int row = 0; row < rows; ++row) out[row * columns + column] = sum[row] / (12.0 * h);
    }
  }
  // D by state and joint, whether each joint sticks, and how many states its drive has.
  ARM_ONCE void write_structure(Real* out) const {
    n.for_each_drive([&](const auto& drive, int j) {
      const auto D = drive.D(modes.drive_modes(drive, j).active());
      for (int k = 0; k < drive.states; ++k) out[k * N + j] = D.f[k];
      out[K * N + j] = modes.friction.locked[j] ? 1.0 : 0.0;
      out[(K + 1) * N + j] = drive.states;
    });
  }

  static Real& number(State<S>& x, int place) {
    const int k = place / N, j = place % N;
    return k < K ? x.z[k][j] : k == K ? x.q[j] : x.v[j];
  }

 private:
  const Numbers<S>& n;
  Modes<S> modes;
  Real step = 0x1p-12;  // of all but speeds

  static Real step_at(Real middle, Real h) {
    while (h < 1e-8 * magnitude(middle)) h *= 2.0;
    return h;
  }

  Modes<S> modes_at(State<S> x, const Real* u, bool slides) const {
    Modes<S> at = Modes<S>::find_at(n, x, u);
    if (!slides) return at;
    at.friction = {};
    n.for_each_drive([&]<class Drive>(const Drive&, int j) {
      if constexpr (Drive::elastic && Drive::of_extras > Drive::of_rotor)
        at.drive[j].at[Drive::of_rotor] = {};
    });
    return at;
  }

  ARM_APART void rates(const State<S>& x, const Real* u, Real* out) const {
    modes.for_each_drive_rate(
        x, u, [&](const auto& drive, int j, const auto& at, unsigned, const Real* f, Real a) {
          for (int k = 0; k < K; ++k) out[k * N + j] = k < drive.states ? f[k] : 0.0;
          out[K * N + j] = a;
          out[(K + 1) * N + j] = drive.current(at);
          out[(K + 2) * N + j] = drive.motor_angle(at);
        });
  }
};

}  // namespace arm
