// The temperature of a gear and its grease, as one body: its rise Theta over the ambient [K] is a
// state, which the friction of rotor and link heats,
//
//   C dTheta/dt = P - Theta / Rth + (T_winding - T) / Rw      T = ambient + Theta
//
// and which changes that friction: viscous torques by the factor f_v, dry ones by f_d,
//
//   f_v = r + (1 - r) exp(-(T - Tref) / Tv)      f_d = max(0, 1 + c (T - Tref))
//
// A. C. Bittencourt et al., An extended friction model to capture load and temperature effects in
// robot joints, IROS 2010, has this form of f_v.
#pragma once

#include "numerics/exponential.hpp"
#include "parts/frictions/friction.hpp"
#include "parts/joint_effects/no_torque.hpp"

namespace arm {

struct GearTemperature : NoTorque<Place::link> {
  constexpr bool operator==(const GearTemperature&) const = default;

  Real C;          // J/K
  Real Rth;        // K/W, to the ambient
  Real ambient;    // degC
  Real reference;  // degC, Tref, of the friction's numbers
  Real r = 0.0;    // share of viscous friction that remains in heat
  Real Tv = 0.0;   // K; 0: viscous friction is constant
  Real c = 0.0;    // 1/K
  Real Rw = 0.0;   // K/W, to the winding; 0: none

  static constexpr int states = 1;

  // The body as it cools, which neither friction nor a winding heats.
  struct Cooling : NoTorque<Place::link> {
    constexpr bool operator==(const Cooling&) const = default;

    Real time;  // s

    static constexpr int states = 1;
    constexpr const Cooling& linear() const { return *this; }
    template <class X>
    ARM_INLINE constexpr void rates(X, X, const X* rise, X* f) const {
      f[0] = -rise[0] / time;
    }
  };
  constexpr Cooling linear() const { return {{}, C * Rth}; }

  template <class X>
  ARM_INLINE constexpr void rates(X angle, X speed, const X* rise, X* f) const {
    linear().rates(angle, speed, rise, f);
  }
  // Rate by the power of friction, and that from a winding at this temperature [K/s].
  template <class X>
  ARM_INLINE constexpr X temperature_rate(X power) const {
    return power / C;
  }
  template <class X>
  ARM_INLINE constexpr X power_from_winding(X winding, X rise) const {
    return Rw > 0.0 ? (winding - (ambient + rise)) / Rw : X{};
  }
  template <class X>
  ARM_INLINE constexpr FrictionFactors<X> compute_factors(X rise) const {
    const X above = ambient - reference + rise, dry = 1.0 + c * above;
    return {Tv > 0.0 ? r + (1.0 - r) * exponential(-above / Tv) : X{} + 1.0,
            select(dry > 0.0, dry, X{})};
  }
};

// A law of friction that follows the temperature.
template <class Law>
struct Warm : Law {
  // g++ 11 leaves the base out of a defaulted comparison.
  constexpr bool operator==(const Warm& other) const { return Law::operator==(other); }

  static constexpr bool varies = true, depends_on_temperature = true;
  template <class X>
  ARM_INLINE constexpr X sliding_torque(X w, const ShaftTorques<X>& on) const {
    return Law::sliding_torque(w, on) * on.factors.dry;
  }
  template <class X>
  ARM_INLINE constexpr X holding_torque(const ShaftTorques<X>& on) const {
    return Law::holding_torque(on) * on.factors.dry;
  }
};

}  // namespace arm
