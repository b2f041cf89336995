// A motor with ideal current control: its current follows the command u [A].
//
//   1 / (2 pi f) di/dt = u - i          torque  Kt i          f: bandwidth of that control
//
// Without a bandwidth it follows at once. The supply delivers the power of winding and shaft.
#pragma once

#include "numerics/number.hpp"
#include "parts/command.hpp"

namespace arm {

struct CurrentMotor {
  constexpr bool operator==(const CurrentMotor&) const = default;

  Real Kt;                   // N m/A
  Real R = 0.0;              // ohm
  Real Mm;                   // kg m2, with the gear's primary side
  Real bandwidth = 0.0;      // Hz; 0: the current follows at once
  Real current_limit = 0.0;  // A; 0: none

  static constexpr bool present = true;
  static constexpr int states = 1;     // i [A]
  static constexpr int regulated = 1;  // of them, see open_winding.hpp
  static constexpr int modes = 0;
  static constexpr Command takes = Command::current;

  constexpr const CurrentMotor& linear() const { return *this; }

  // A command is within the limit, and so is a current that follows it.
  template <class X>
  ARM_INLINE constexpr X largest_command(const X*, Real) const {
    return X{} + limit_or_none(current_limit);
  }
  constexpr Real largest_current() const { return current_limit; }

  constexpr Real inertia(int, bool) const { return time_constant(bandwidth); }
  template <class X>
  ARM_INLINE constexpr void rates(const X* i, X u, X, X, X, bool, X* f) const {
    f[0] = u - i[0];
  }
  template <class X>
  ARM_INLINE constexpr X torque(const X* i, X) const {
    return Kt * i[0];
  }
  template <class X>
  ARM_INLINE constexpr X current(const X* i) const {
    return i[0];
  }
  constexpr void set_current(Real* i, Real current) const { i[0] = current; }
  constexpr void set_algebraic_state(Real* i, Real u, Real) const {
    if (bandwidth == 0.0) i[0] = u;
  }

  template <class X>
  ARM_INLINE constexpr X stored_energy(const X*) const {
    return X{};
  }
  template <class X>
  ARM_INLINE constexpr X dissipated_power(const X* i) const {
    return R * i[0] * i[0];
  }
  template <class X>
  ARM_INLINE constexpr X supplied_power(const X* i, X, X, X wm, bool) const {
    return (R * i[0] + Kt * wm) * i[0];
  }
  static constexpr bool supply_grows_with_speed = true;  // so that it may grow from nothing at rest
  template <class X>
  ARM_INLINE constexpr X supply_limit(const X* i, X u, X wm) const {
    const X largest = larger_size(i[0], u);
    return (R * largest + Kt * magnitude(wm)) * largest;
  }
};

}  // namespace arm
