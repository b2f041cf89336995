// A spring and a damper that push and never pull: a tooth on a tooth, a link on its stop.
//
// With the depth u of contact,
//
//   T = max(0, K u + D du/dt) where u > 0, else 0
//
// It stores K u^2 / 2 and dissipates T du/dt - K u du/dt, which is D (du/dt)^2 while it pushes.
// If the other body leaves faster than the spring extends, T is 0, and the damper absorbs the
// spring's remaining force.
#pragma once

#include "numerics/number.hpp"

namespace arm {

struct UnilateralSpring {
  constexpr bool operator==(const UnilateralSpring&) const = default;

  Real K;  // N m/rad
  Real D;  // N m s/rad

  template <class X>
  ARM_INLINE constexpr X push_torque(X u, X du) const {
    return K * u + D * du;
  }
  constexpr bool is_pushing(Real u, Real du) const { return u > 0.0 && push_torque(u, du) > 0.0; }

  // Distance from the change between pushing and not, negative beyond [N m].
  constexpr Real margin(bool pushing, Real u, Real du, Real rounding) const {
    const Real depth = K * u, torque = push_torque(u, du);
    const Real smaller = depth < torque ? depth : torque;
    return (pushing ? smaller : -smaller) + rounding;
  }

  template <class X>
  ARM_INLINE constexpr X stored_energy(X u) const {
    return select(u > 0.0, 0.5 * K * u * u, X{});
  }
  // While it pushes, and while it does not.
  constexpr Real dissipated_power(Real u, Real du, bool pushing) const {
    if (pushing) return D * du * du;
    return u > 0.0 ? -K * u * du : 0.0;
  }
};

}  // namespace arm
