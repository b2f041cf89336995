// An elastic gear that stiffens as it winds up, by w = Ng tm - q:
//
//   T = Kg w + Kg3 w^3 + Dg dw/dt      stored  Kg w^2 / 2 + Kg3 w^4 / 4
#pragma once

#include "parts/gears/gear.hpp"

namespace arm {

struct ProgressiveGear {
  constexpr bool operator==(const ProgressiveGear&) const = default;

  Real Ng;   // link turns per motor turn
  Real Kg;   // N m/rad at the link
  Real Dg;   // N m s/rad at the link
  Real Kg3;  // N m/rad3 at the link

  static constexpr bool rigid = false;
  static constexpr int states = ElasticGear::states;
  static constexpr int modes = 0;

  // The same gear without the cubic term.
  constexpr ElasticGear linear() const { return {Ng, Kg, Dg}; }

  template <class X>
  ARM_INLINE constexpr X torque(X tm, X wm, X q, X v, X none, bool active) const {
    return linear().torque(tm, wm, q, v, none, active) + beyond_linear(tm, q);
  }
  // Torque that it adds to that of the linear gear.
  template <class X>
  ARM_INLINE constexpr X beyond_linear(X tm, X q) const {
    const X w = Ng * tm - q;
    return Kg3 * w * w * w;
  }
  template <class X>
  ARM_INLINE constexpr X stored_energy(X tm, X q) const {
    const X w = Ng * tm - q;
    return linear().stored_energy(tm, q) + 0.25 * Kg3 * (w * w) * (w * w);
  }
  template <class X>
  ARM_INLINE constexpr X dissipated_power(X tm, X wm, X q, X v, bool active) const {
    return linear().dissipated_power(tm, wm, q, v, active);
  }
};

}  // namespace arm
