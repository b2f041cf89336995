// A permanent-magnet synchronous motor in the frame of its rotor, d along the magnets' flux, in
// amplitudes of its phases:
//
//   Ld did/dt = ud - (R + R_contact) id + p wm Lq iq
//   Lq diq/dt = uq - (R + R_contact) iq - p wm (Ld id + psi)
//   torque      3/2 p (psi iq + (Ld - Lq) id iq)
//
// An inverter with space vectors reaches the amplitude supply / sqrt(3). ud has priority, and uq
// the rest of that circle.
#pragma once

#include "numerics/number.hpp"
#include "parts/command.hpp"

namespace arm {

// `whole` false: without the products of speed and currents, which is linear.
template <bool whole>
struct PmsmOf {
  constexpr bool operator==(const PmsmOf&) const = default;

  Real R;                    // ohm
  Real Ld;                   // H
  Real Lq;                   // H
  Real psi;                  // V s, flux of the magnets
  Real p;                    // pole pairs
  Real Mm;                   // kg m2, with the gear's primary side
  Real current_limit = 0.0;  // A, of its drive's current loops; 0: none
  Real R_contact = 0.0;      // ohm, in series with each phase, which it does not heat

  static constexpr bool present = true;
  static constexpr int states = 3;  // id [A], iq [A], ud [V], which rests
  static constexpr int modes = 0;
  static constexpr Command takes = Command::voltage_dq;  // uq
  static constexpr int further = 1;                      // ud

  constexpr PmsmOf<false> linear() const {
    return {R, Ld, Lq, psi, p, Mm, current_limit, R_contact};
  }

  constexpr Real inertia(int k, bool) const { return k == 0 ? Ld : k == 1 ? Lq : 1.0; }
  template <class X>
  ARM_INLINE constexpr void rates(const X* z, X uq, X, X wm, X, bool, X* f) const {
    const X id = z[0], iq = z[1], ud = z[2];
    f[0] = ud - R_circuit() * id;
    f[1] = uq - R_circuit() * iq - p * psi * wm;
    f[2] = X{};
    if constexpr (whole) {
      f[0] += p * Lq * wm * iq;
      f[1] -= p * Ld * wm * id;
    }
  }
  template <class X>
  ARM_INLINE constexpr X torque(const X* z, X) const {
    if constexpr (whole) return 1.5 * p * (psi + (Ld - Lq) * z[0]) * z[1];
    return 1.5 * p * psi * z[1];
  }

  // iq is the motor's current; id is reported separately.
  template <class X>
  ARM_INLINE constexpr X current(const X* z) const {
    return z[1];
  }
  constexpr void set_current(Real* z, Real current) const { z[1] = current; }
  constexpr Real R_circuit() const { return R + R_contact; }
  constexpr Real current_d(const Real* z) const { return z[0]; }
  constexpr Real largest_current() const { return 0.0; }
  static constexpr bool never_algebraic = true;
  constexpr void set_algebraic_state(Real*, Real, Real) const {}

  // A further input is a constant state: held between commands, and saved with the states.
  constexpr void set_further_input(int, Real* z, Real ud, Real supply) const {
    z[2] = clamp(ud, amplitude(supply));
  }
  constexpr Real applied_inputs(int, const Real* z) const { return z[2]; }
  template <class X>
  ARM_INLINE constexpr X largest_command(const X* z, Real supply) const {
    const X left = amplitude(supply) * amplitude(supply) - z[2] * z[2];
    return square_root(select(left > 0.0, left, X{}));
  }

  template <class X>
  ARM_INLINE constexpr X stored_energy(const X* z) const {
    return 0.75 * (Ld * z[0] * z[0] + Lq * z[1] * z[1]);
  }
  template <class X>
  ARM_INLINE constexpr X dissipated_power(const X* z) const {
    return 1.5 * R_circuit() * (z[0] * z[0] + z[1] * z[1]);
  }
  template <class X>
  ARM_INLINE constexpr X copper_loss(const X* z) const {
    return 1.5 * R * (z[0] * z[0] + z[1] * z[1]);
  }
  template <class X>
  ARM_INLINE constexpr X supplied_power(const X* z, X uq, X, X, bool) const {
    return 1.5 * (z[2] * z[0] + uq * z[1]);
  }
  // Upper bound, at the best currents.
  template <class X>
  ARM_INLINE constexpr X supply_limit(const X* z, X uq, X) const {
    return 0.375 / R * (z[2] * z[2] + uq * uq);
  }

 private:
  static constexpr Real amplitude(Real supply) { return supply / 1.7320508075688772; }
};

using Pmsm = PmsmOf<true>;

}  // namespace arm
