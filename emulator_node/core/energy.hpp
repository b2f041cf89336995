// Energy of a machine, and the proof by it that a motion is none.
#pragma once

#include "links.hpp"
#include "motors.hpp"
#include "state.hpp"

namespace arm {

struct Energy {
  double stored;     // J, kinetic, elastic and magnetic, of links, gears and motors: never negative
  double potential;  // J, of the links in the field S::gravity

  double total() const { return stored + potential; }
};

// What joint j itself has of it: its motor, its gear and, with M_jj for `inertia`, its link.
ARM_INLINE double stored_energy(const Joint& joint, double inertia, double i, double tm, double wm,
                                double q, double v) {
  double twice = inertia * v * v;
  if (joint.motor.present) {
    if (joint.gear.rigid) {
      twice += carried_rotor(joint) * v * v;
    } else {
      const double twist = joint.gear.Ng * tm - q;
      twice += joint.motor.Mm * wm * wm + joint.gear.Kg * twist * twist;
    }
    twice += joint.motor.L * i * i;
  }
  return 0.5 * twice;
}

// `greediest`: set to the joint that holds the most.
template <class S>
Energy energy_of(const State<S::N>& x, int* greediest = nullptr) {
  typename Links<S>::Kinematics k;
  typename Links<S>::MassMatrix M;
  Links<S>::kinematics(x.q, k);
  Links<S>::mass_matrix(k, M);
  Energy E = {0.0, Links<S>::potential_energy(k)};
  double most = -1.0;
  for (int j = 0; j < S::N; ++j) {
    const double own =
        stored_energy(S::joint[j], M.at[j][j], x.i[j], x.tm[j], x.wm[j], x.q[j], x.v[j]);
    E.stored += own;
    for (int m = j + 1; m < S::N; ++m) E.stored += x.v[j] * M.at[j][m] * x.v[m];
    if (greediest && own > most) {
      most = own;
      *greediest = j;
    }
  }
  return E;
}

// What a motor at V volts gives at most [W]: V i - R i^2, and (Kt - Kb) wm i where the constants
// differ, for the best i.
ARM_INLINE constexpr double largest_power(const Joint& joint, double V, double wm) {
  if (!joint.motor.present) return 0.0;
  const double from_nowhere = (joint.motor.Kt - joint.motor.Kb) * wm;
  const double U = (V < 0.0 ? -V : V) + (from_nowhere < 0.0 ? -from_nowhere : from_nowhere);
  return U * U / (4.0 * joint.motor.R);
}

// Keeps account of a machine's energy. Friction, gear damping and windings only take, so that it
// never exceeds what it was at any time before and what the motors can have given since. Where it
// does, by half of the most that was ever stored, the scheme makes it: such numbers may be finite
// and look like a motion, but are none.
template <class S>
class EnergyBalance {
 public:
  static constexpr int N = S::N;

  void reset(const State<N>& x) {
    const Energy E = energy_of<S>(x);
    at_most = E.total();
    largest_stored = E.stored;
    steps = 0;
  }

  // What the motors give at most at the voltages V [W].
  ARM_INLINE static double largest_power(const State<N>& x, const double (&V)[N]) {
    double power = 0.0;
    for_each<N>([&](auto j) __attribute__((always_inline)) {
      power += arm::largest_power(S::joint[j], V[j],
                                  S::joint[j].gear.rigid ? x.v[j] / S::joint[j].gear.Ng : x.wm[j]);
    });
    return power;
  }

  // The motors have given at most E [J].
  void give(double E) { at_most += E; }

  // `count` steps have led to x. Returns -1, or the joint that holds the most of an energy that
  // came from nowhere.
  int broken_by(const State<N>& x, int count) {
    steps += count;
    if (steps < kCheckEvery) return -1;
    steps = 0;
    int greediest = 0;
    const Energy E = energy_of<S>(x, &greediest);
    if (E.stored > largest_stored) largest_stored = E.stored;
    const double gained = E.total() - at_most;
    const double rounding = kRounding * (1.0 + (E.potential < 0.0 ? -E.potential : E.potential));
    if (gained > kTolerance * largest_stored + rounding) return greediest;
    if (gained < 0.0) at_most = E.total();
    return -1;
  }

 private:
  static constexpr int kCheckEvery = 64;
  static constexpr double kTolerance = 0.5;
  static constexpr double kRounding = 1e-9;  // of 1 J, and of the potential energy

  double at_most = 0.0;         // J
  double largest_stored = 0.0;  // J
  int steps = 0;                // since the last look
};

}  // namespace arm
