// Gears between motor and link, eq. (2). One that is not linear: progressive_gear.hpp. One with
// play: backlash.hpp.
#pragma once

#include "numerics/number.hpp"

namespace arm {

// A spring and a damper between the rotor, reduced, and the link.
struct ElasticGear {
  constexpr bool operator==(const ElasticGear&) const = default;

  Real Ng;  // link turns per motor turn
  Real Kg;  // N m/rad at the link
  Real Dg;  // N m s/rad at the link

  static constexpr bool rigid = false;
  static constexpr int states = 2;  // tm [rad], wm [rad/s] of the rotor
  static constexpr int modes = 0;

  // See drive.hpp.
  constexpr const ElasticGear& linear() const { return *this; }

  // Torque T on the link.
  template <class X>
  ARM_INLINE constexpr X torque(X tm, X wm, X q, X v, X, bool) const {
    return Kg * (Ng * tm - q) + Dg * (Ng * wm - v);
  }
  template <class X>
  ARM_INLINE constexpr X stored_energy(X tm, X q) const {
    const X twist = Ng * tm - q;
    return 0.5 * Kg * twist * twist;
  }
  template <class X>
  ARM_INLINE constexpr X dissipated_power(X, X wm, X, X v, bool) const {
    const X rate = Ng * wm - v;
    return Dg * rate * rate;
  }
};

// The rotor turns with its link and has no state of its own.
struct RigidGear {
  constexpr bool operator==(const RigidGear&) const = default;

  Real Ng = 1.0;

  static constexpr bool rigid = true;
  static constexpr int states = 0, modes = 0;
  constexpr const RigidGear& linear() const { return *this; }
};

}  // namespace arm
