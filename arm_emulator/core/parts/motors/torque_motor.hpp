// A motor with ideal torque control: its torque tau follows the command u [N m].
//
//   1 / (2 pi f) dtau/dt = u - tau          f: bandwidth of that control
//
// Without a bandwidth it follows at once. The supply delivers the shaft's power; there is no
// current.
#pragma once

#include "numerics/number.hpp"
#include "parts/command.hpp"

namespace arm {

struct TorqueMotor {
  constexpr bool operator==(const TorqueMotor&) const = default;

  Real Mm;                  // kg m2, with the gear's primary side
  Real bandwidth = 0.0;     // Hz; 0: the torque follows at once
  Real torque_limit = 0.0;  // N m; 0: none

  static constexpr bool present = true;
  static constexpr int states = 1;     // tau [N m]
  static constexpr int regulated = 1;  // of them, see open_winding.hpp
  static constexpr int modes = 0;
  static constexpr Command takes = Command::torque;

  constexpr const TorqueMotor& linear() const { return *this; }

  // A command is within the limit, and so is a torque that follows it.
  template <class X>
  ARM_INLINE constexpr X largest_command(const X*, Real) const {
    return X{} + limit_or_none(torque_limit);
  }
  constexpr Real largest_current() const { return 0.0; }

  constexpr Real inertia(int, bool) const { return time_constant(bandwidth); }
  template <class X>
  ARM_INLINE constexpr void rates(const X* tau, X u, X, X, X, bool, X* f) const {
    f[0] = u - tau[0];
  }
  template <class X>
  ARM_INLINE constexpr X torque(const X* tau, X) const {
    return tau[0];
  }
  template <class X>
  ARM_INLINE constexpr X current(const X*) const {
    return X{};
  }
  constexpr void set_current(Real*, Real) const {}
  constexpr void set_algebraic_state(Real* tau, Real u, Real) const {
    if (bandwidth == 0.0) tau[0] = u;
  }

  template <class X>
  ARM_INLINE constexpr X stored_energy(const X*) const {
    return X{};
  }
  template <class X>
  ARM_INLINE constexpr X dissipated_power(const X*) const {
    return X{};
  }
  template <class X>
  ARM_INLINE constexpr X supplied_power(const X* tau, X, X, X wm, bool) const {
    return tau[0] * wm;
  }
  static constexpr bool supply_grows_with_speed = true;  // so that it may grow from nothing at rest
  template <class X>
  ARM_INLINE constexpr X supply_limit(const X* tau, X u, X wm) const {
    return larger_size(tau[0], u) * magnitude(wm);
  }
};

}  // namespace arm
