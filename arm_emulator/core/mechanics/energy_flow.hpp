// Energy that the supply and external wrenches give to each joint and that each joint dissipates,
// at an instant and over a motion. With the stored energy (energy.hpp) the balance must close,
//
//   energy(t1) - energy(t0) = sum over the joints of given - dissipated
//
// up to the error of the scheme.
#pragma once

#include "mechanics/drive_energy.hpp"
#include "mechanics/modes.hpp"

namespace arm {

// In W at an instant, in J over a motion.
template <class S>
struct EnergyFlow {
  Real supplied[S::N] = {}, dissipated[S::N] = {};

  void add(const EnergyFlow& flow, Real factor) {
    for (int j = 0; j < S::N; ++j) {
      supplied[j] += factor * flow.supplied[j];
      dissipated[j] += factor * flow.dissipated[j];
    }
  }
};

// The powers at the state x in these modes.
template <class S>
EnergyFlow<S> compute_powers(const Numbers<S>& n, const State<S>& x, const Real* u,
                             const Modes<S>& modes) {
  EnergyFlow<S> power;
  n.for_each_drive([&](const auto& drive, int j) {
    const auto now = modes.drive_modes(drive, j);
    const auto at = drive.apply_modes(input_of(drive, j, x, u[j]), now);
    power.supplied[j] = compute_supplied_power(drive, at, now.active());
    power.dissipated[j] = compute_dissipation(drive, at, now.active());
  });
  if constexpr (S::external_wrench) {
    typename Links<S>::Kinematics kinematics;
    Real torque[S::N];
    Links<S>::compute_kinematics(n, x.q, kinematics);
    Links<S>::compute_external_torques(n, kinematics, torque);
    for (int j = 0; j < S::N; ++j) power.supplied[j] += torque[j] * x.v[j];
  }
  return power;
}

// Integrates the powers along a motion, one smooth part after the other, by Simpson's rule with the
// state in the middle from Hermite's cubic: its error is t^5 for a part of length t, so the
// residual of the balance is the scheme's.
template <class S>
class EnergyMeter {
 public:
  static constexpr int N = S::N;

  explicit EnergyMeter(const Numbers<S>& numbers) : n_(numbers) {}

  // A part from x to y, in these modes, t long.
  void add_part(State<S> x, State<S> y, const Real* u, const Modes<S>& modes, Real t) {
    set_algebraic_states(n_, x, u);
    set_algebraic_states(n_, y, u);
    const State<S> middle = interpolate_middle(x, y, u, modes, t);
    total.add(compute_powers(n_, x, u, modes), t / 6.0);
    total.add(compute_powers(n_, middle, u, modes), 4.0 * t / 6.0);
    total.add(compute_powers(n_, y, u, modes), t / 6.0);
  }

  EnergyFlow<S> total;

 private:
  const Numbers<S>& n_;

  State<S> interpolate_middle(const State<S>& x, const State<S>& y, const Real* u,
                              const Modes<S>& modes, Real t) const {
    const State<S> before = compute_state_rates(x, u, modes),
                   after = compute_state_rates(y, u, modes);
    State<S> middle = x;
    const auto put = [t](Real& m, Real x, Real y, Real before, Real after) {
      m = 0.5 * (x + y) + 0.125 * t * (before - after);
    };
    for (int j = 0; j < N; ++j) {
      for (int k = 0; k < State<S>::K; ++k)
        put(middle.z[k][j], x.z[k][j], y.z[k][j], before.z[k][j], after.z[k][j]);
      put(middle.q[j], x.q[j], y.q[j], before.q[j], after.q[j]);
      put(middle.v[j], x.v[j], y.v[j], before.v[j], after.v[j]);
    }
    set_algebraic_states(n_, middle, u);
    return middle;
  }

  // dx/dt; 0 for algebraic states.
  State<S> compute_state_rates(const State<S>& x, const Real* u, const Modes<S>& modes) const {
    State<S> rates = {};
    modes.for_each_drive_rate(
        x, u, [&](const auto& drive, int j, const auto&, unsigned active, const Real* f, Real a) {
          const auto D = drive.D(active);
          for (int k = 0; k < drive.states; ++k)
            if (D.f[k] > 0.0) rates.z[k][j] = f[k] / D.f[k];
          rates.q[j] = x.v[j];
          rates.v[j] = a;
        });
    return rates;
  }
};

}  // namespace arm
