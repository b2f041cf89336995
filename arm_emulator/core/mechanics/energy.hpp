// Energy of a machine, which detects non-physical motion.
#pragma once

#include <cstdint>

#include "mechanics/drive_energy.hpp"
#include "mechanics/links/links.hpp"
#include "mechanics/state.hpp"

namespace arm {

struct Energy {
  Real stored;     // J, kinetic, elastic and magnetic, of links, gears and motors: never negative
  Real potential;  // J, of the links in the field of gravity, and of extras
  Real jolt;       // N2 m2/(kg m2), sum of Dc^2 / M_jj, for the bound on dry friction

  Real total() const { return stored + potential; }
};

// `largest_joint`: set to the joint with the most energy, that of its drive and, with M_jj, its
// link.
template <class S>
__attribute__((noinline)) Energy compute_energy(const Numbers<S>& n, const State<S>& x,
                                                int* largest_joint = nullptr) {
  typename Links<S>::Kinematics k;
  typename Links<S>::MassMatrix M;
  Links<S>::compute_kinematics(n, x.q, k);
  Links<S>::compute_mass_matrix(n, k, M);
  Energy E = {0.0, Links<S>::compute_potential_energy(n, k), 0.0};
  Real most = -1.0;
  n.for_each_drive([&]<class Drive>(const Drive& drive, int j) {
    const Real joint_energy = 0.5 * M.at[j][j] * x.v[j] * x.v[j] +
                              compute_drive_energy(drive, input_of(drive, j, x, 0.0));
    E.stored += joint_energy;
    if constexpr (Drive::has_potential)
      E.potential += compute_potential(drive, input_of(drive, j, x, 0.0));
    Real Dc = n.Dc(j);
    if constexpr (Drive::friction_varies) {
      const auto at = input_of(drive, j, x, 0.0);
      const auto modes = drive.modes_at(at);
      Dc = drive.sliding_torque(drive.apply_modes(at, modes), modes.active(), sign_of(x.v[j]));
    }
    E.jolt += Dc * Dc / (M.at[j][j] + n.carried(j));
    for (int m = j + 1; m < S::N; ++m) E.stored += x.v[j] * M.at[j][m] * x.v[m];
    if (largest_joint && joint_energy > most) {
      most = joint_energy;
      *largest_joint = j;
    }
  });
  return E;
}

// Keeps account of a machine's energy. Friction, gear damping and windings only dissipate, so the
// energy never exceeds an earlier value plus the largest supply since. If it does, by half of the
// largest energy so far, the scheme has created it: such numbers may be finite and look like a
// motion.
template <class S>
class EnergyBalance {
 public:
  static constexpr int N = S::N;

  void reset(const Numbers<S>& n, const State<S>& x) {
    const Energy E = compute_energy<S>(n, x);
    energy_limit_ = E.total();
    largest_stored_ = E.stored;
    steps_ = 0;
  }

  // Largest power that the motors can supply under the commands u [W].
  template <class X>
  ARM_INLINE static X largest_power(const Numbers<S, X>& n, const State<S, X>& x, const X* u) {
    X power = {};
    if constexpr (kWidth<X> == 1 || !Numbers<S, X>::drives_vary) {
      n.for_each_drive([&](const auto& drive, int j) __attribute__((always_inline)) {
        power += compute_supply_limit(drive, input_of(drive, j, x, u[j]));
      });
      return power;
    }
    for (int lane = 0; lane < kWidth<X>; ++lane) {
      Real lane_schedule = 0.0;
      n.for_each_drive_of(lane, [&](const auto& drive, int j) __attribute__((always_inline)) {
        lane_schedule += compute_supply_limit(drive, input_in_lane(drive, j, x, u[j], lane));
      });
      set_lane(power, lane, lane_schedule);
    }
    return power;
  }

  // Upper bound of the energy [J]; each step adds the largest power of the motors.
  Real energy_limit() const { return energy_limit_; }
  void set_energy_limit(Real E) { energy_limit_ = E; }

  // Count steps. Returns whether a check is due.
  bool is_due_after(int count) {
    steps_ += count;
    if (steps_ < kCheckEvery) return false;
    steps_ = 0;
    return true;
  }
  // Check the state x. Returns -1, or the joint with most of the energy that the scheme created.
  int find_violation(const Numbers<S>& n, const State<S>& x, Real h) {
    int largest_joint = 0;
    const Energy E = compute_energy<S>(n, x, &largest_joint);
    if (E.stored > largest_stored_) largest_stored_ = E.stored;
    const Real gained = E.total() - energy_limit_;
    const Real rounding = kRounding * (1.0 + (E.potential < 0.0 ? -E.potential : E.potential));
    // A joint that stops within a step keeps its friction until the step's end (coulomb.hpp): Dc,
    // for h at most, gives the others at most (Dc h)^2 / (2 M).
    const Real jolt = kStops * E.jolt * h * h;
    if (gained > kTolerance * largest_stored_ + rounding + jolt) return largest_joint;
    if (gained < 0.0) energy_limit_ = E.total();
    return -1;
  }

  // number(x) for everything that it remembers, in a fixed order.
  template <class Number>
  void for_each_number(Number&& number) {
    number(energy_limit_);
    number(largest_stored_);
    number(steps_);
  }

 private:
  static constexpr int kCheckEvery = 64;
  static constexpr double kTolerance = 0.5;
  static constexpr double kStops = 10.0;     // stops allowed between two checks
  static constexpr double kRounding = 1e-9;  // of 1 J, and of the potential energy

  Real energy_limit_ = 0.0;    // J
  Real largest_stored_ = 0.0;  // J
  std::int64_t steps_ = 0;     // since the last check
};

}  // namespace arm
