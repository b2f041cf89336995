// A hybrid stepper behind drivers that regulate the currents of its two phases:
//
//   1 / (2 pi f) dia/dt = ua - ia          torque  Kt (ib cos(p tm) - ia sin(p tm))
//   1 / (2 pi f) dib/dt = ub - ib          p: teeth of the rotor
//
// Currents I cos(phi), I sin(phi) hold the rotor at phi / p. The supply delivers the power of
// windings and shaft.
#pragma once

#include "numerics/number.hpp"
#include "numerics/sincos.hpp"
#include "parts/command.hpp"

namespace arm {

// `whole` false: without torque, which is linear.
template <bool whole>
struct StepperMotorOf {
  constexpr bool operator==(const StepperMotorOf&) const = default;

  Real Kt;                   // N m/A, the most of a phase
  Real R = 0.0;              // ohm, of a phase
  Real p;                    // teeth
  Real Mm;                   // kg m2, with the gear's primary side
  Real bandwidth;            // Hz
  Real current_limit = 0.0;  // A, of a phase; 0: none

  static constexpr bool present = true;
  static constexpr int states = 3;     // ia, ib [A], ub [A], which rests
  static constexpr int regulated = 2;  // the first of them, see open_winding.hpp
  static constexpr int modes = 0;
  static constexpr Command takes = Command::current;  // ua
  static constexpr int further = 1;                   // ub

  constexpr StepperMotorOf<false> linear() const {
    return {Kt, R, p, Mm, bandwidth, current_limit};
  }

  template <class X>
  ARM_INLINE constexpr X largest_command(const X*, Real) const {
    return X{} + limit_or_none(current_limit);
  }
  constexpr Real largest_current() const { return current_limit; }
  constexpr void set_further_input(int, Real* z, Real ub, Real) const {
    z[2] = clamp(ub, limit_or_none(current_limit));
  }
  constexpr Real applied_inputs(int, const Real* z) const { return z[2]; }

  constexpr Real inertia(int k, bool) const { return k < 2 ? time_constant(bandwidth) : 1.0; }
  template <class X>
  ARM_INLINE constexpr void rates(const X* z, X ua, X, X, X, bool, X* f) const {
    f[0] = ua - z[0], f[1] = z[2] - z[1], f[2] = X{};
  }
  template <class X>
  ARM_INLINE constexpr X torque(const X* z, X tm) const {
    if constexpr (!whole) return X{};
    // Compile-time evaluation is only of the machine without currents.
    if (__builtin_is_constant_evaluated()) return X{};
    const auto at = sincos(X(p * tm));
    return Kt * (z[1] * at.cos - z[0] * at.sin);
  }
  template <class X>
  ARM_INLINE constexpr X current(const X* z) const {
    return z[0];
  }
  constexpr void set_current(Real* z, Real current) const { z[0] = current; }
  constexpr void set_algebraic_state(Real*, Real, Real) const {}

  template <class X>
  ARM_INLINE constexpr X stored_energy(const X*) const {
    return X{};
  }
  template <class X>
  ARM_INLINE constexpr X dissipated_power(const X* z) const {
    return R * (z[0] * z[0] + z[1] * z[1]);
  }
  template <class X>
  ARM_INLINE constexpr X supplied_power(const X* z, X, X tm, X wm, bool) const {
    return dissipated_power(z) + torque(z, tm) * wm;
  }
  static constexpr bool supply_grows_with_speed = true;  // so that it may grow from nothing at rest
  template <class X>
  ARM_INLINE constexpr X supply_limit(const X* z, X ua, X wm) const {
    const X a = larger_size(z[0], ua), b = larger_size(z[1], z[2]);
    return R * (a * a + b * b) + Kt * magnitude(wm) * (a + b);
  }
};

using StepperMotor = StepperMotorOf<true>;

}  // namespace arm
