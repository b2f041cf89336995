// The drag of water or air on a link: against its motion, with the square of its speed.
//
//   torque on the link  -c |v| v      dissipated  c |v|^3
#pragma once

#include "parts/joint_effects/no_torque.hpp"

namespace arm {

struct Drag : NoTorque<Place::link> {
  constexpr bool operator==(const Drag&) const = default;

  Real c;  // N m s2/rad2

  template <class X>
  ARM_INLINE constexpr X torque(X, X v, const X*, X, bool) const {
    return -c * magnitude(v) * v;
  }
  constexpr Real dissipated_power(Real, Real v, const Real*, bool) const {
    return c * magnitude(v) * v * v;
  }
};

}  // namespace arm
