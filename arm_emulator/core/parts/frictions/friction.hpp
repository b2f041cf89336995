// Friction of a shaft, of a rotor or of a link: viscous, and Coulomb's.
//
// The torque on a turning shaft is -Dv w - Dc sign(w). A shaft at rest stays at rest exactly while
// the torque on it is at most Ds >= Dc, without regularisation and at any step size. coulomb.hpp
// solves for all links together, rotor_friction.hpp for a rotor.
#pragma once

#include "numerics/number.hpp"

namespace arm {

// Factors of viscous and of dry torques by the temperature (gear_temperature.hpp).
template <class X>
struct FrictionFactors {
  constexpr bool operator==(const FrictionFactors&) const = default;

  X viscous = X{} + 1.0, dry = X{} + 1.0;
};

// Torques on a shaft [N m]. A law that asks for the direction of power gets them as they are in the
// direction in which the shaft moves, or would move: positive where the motor drives.
template <class X>
struct ShaftTorques {
  X of_gear;          // on the link, seen at this shaft
  X of_motor;         // what drives the shaft; at a link that of the gear
  X power_direction;  // above 0: the motor's torque is the greater one; at a link its sign alone
  FrictionFactors<X> factors = {};
};

// Viscous torque of a law against the speed w.
template <class Law, class X>
ARM_INLINE constexpr X viscous_torque(const Law& law, X w, const FrictionFactors<X>& factors) {
  if constexpr (requires { Law::depends_on_temperature; })
    return law.Dv * factors.viscous * w;
  else
    return law.Dv * w;
}

struct Friction {
  constexpr bool operator==(const Friction&) const = default;

  Real Dv = 0.0;            // N m s/rad, viscous
  Real Dc = 0.0, Ds = 0.0;  // N m, while the shaft slides, and what holds it at rest

  // Whether the sliding torque varies. Then its value at a step's start enters the first stage, its
  // change the second.
  static constexpr bool varies = false;
  // Whether the breakaway torque depends on the torque of the gear; whether the direction of power
  // matters, and with it the motor's torque.
  static constexpr bool loaded = false, directed = false;

  // See drive.hpp.
  constexpr const Friction& linear() const { return *this; }

  // This friction with torques of dry friction that all lanes share.
  constexpr Friction without_torques() const { return {Dv, 1.0, 1.0}; }

  // Whether it can hold a shaft at rest; the breakaway torque may still be 0 at times.
  constexpr bool is_dry() const { return Dc > 0.0; }
  // Torques against sliding at the speed w, and that hold at rest, under these torques on the
  // shaft.
  template <class X>
  ARM_INLINE constexpr X sliding_torque(X, const ShaftTorques<X>&) const {
    return X{} + Dc;
  }
  template <class X>
  ARM_INLINE constexpr X holding_torque(const ShaftTorques<X>&) const {
    return X{} + Ds;
  }
};

}  // namespace arm
