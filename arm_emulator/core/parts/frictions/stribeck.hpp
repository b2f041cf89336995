// Friction of a shaft that falls as the shaft begins to slide, by Stribeck (1902) in the form of
// Bo and Pavelescu (1982): from Ds, which holds it at rest, to Dc.
//
//   torque against the motion   Dv w + (Dc + (Ds - Dc) exp(-(w / vs)^2)) sign(w)
#pragma once

#include "numerics/exponential.hpp"
#include "parts/frictions/friction.hpp"

namespace arm {

struct Stribeck {
  constexpr bool operator==(const Stribeck&) const = default;

  Real Dv, Dc, Ds;  // as of Friction
  Real vs;          // rad/s, at 63 % of the fall

  static constexpr bool varies = true, loaded = false, directed = false;
  constexpr Friction linear() const { return {Dv, Dc, Ds}; }

  constexpr bool is_dry() const { return Ds > 0.0; }
  template <class X>
  ARM_INLINE constexpr X sliding_torque(X w, const ShaftTorques<X>&) const {
    return Dc + (Ds - Dc) * exponential(-(w / vs) * (w / vs));
  }
  template <class X>
  ARM_INLINE constexpr X holding_torque(const ShaftTorques<X>&) const {
    return X{} + Ds;
  }
};

}  // namespace arm
