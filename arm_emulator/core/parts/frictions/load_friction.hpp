// Friction of a shaft that grows with the torque T of the gear on that shaft:
//
//   sliding   Dc + mu |T|, or what stribeck.hpp has in the place of Dc      holding   Ds + mu |T|
//
// Of a rotor it is the loss of a gear, mu = 1/efficiency - 1 (docs/reference/parts).
#pragma once

#include "parts/frictions/stribeck.hpp"

namespace arm {

struct LoadFriction {
  constexpr bool operator==(const LoadFriction&) const = default;

  Real Dv = 0.0, Dc = 0.0, Ds = 0.0;  // as of Friction
  Real vs = 0.0;                      // as of Stribeck; 0: the torque of sliding is Dc
  Real mu;                            // N m of friction per N m of the gear's torque

  static constexpr bool varies = true, loaded = true;
  constexpr Friction linear() const { return {Dv, Dc, Ds}; }

  constexpr bool is_dry() const { return Ds > 0.0 || mu > 0.0; }
  template <class X>
  ARM_INLINE constexpr X sliding(X w, X T) const {
    const X dry = vs > 0.0 ? Stribeck{Dv, Dc, Ds, vs}.sliding(w, T) : X{} + Dc;
    return dry + mu * magnitude(T);
  }
  template <class X>
  ARM_INLINE constexpr X holding(X T) const {
    return Ds + mu * magnitude(T);
  }
};

}  // namespace arm
