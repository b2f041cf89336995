// Friction of a shaft that grows with the torque T of the gear on that shaft:
//
//   sliding   Dc + mu |T|, or what stribeck.hpp has in the place of Dc      holding   Ds + mu |T|
//
// Of a rotor it is the loss of a gear, mu = 1/efficiency - 1 (docs/reference/parts).
//
// DirectedLoadFriction knows the direction of power, the motor's torque A, and terms that fade with
// the speed as the torque of breaking away does:
//
//   Dc + |m A + mu T| + exp(-|w / vs|^alpha) (Ds - Dc + |n A + nu T| + Q)
//   Q   where A and T oppose each other on the shaft: q T^2 if |A| > |T|, else q_back A^2
//
// mu and nu are others where the link drives the motor. LoadFriction has one mu alone.
#pragma once

#include "parts/frictions/stribeck.hpp"

namespace arm {

struct LoadFriction {
  constexpr bool operator==(const LoadFriction&) const = default;

  Real Dv = 0.0, Dc = 0.0, Ds = 0.0;  // as of Friction
  Real vs = 0.0;                      // as of Stribeck; 0: the torque of sliding is Dc
  Real mu;                            // N m of friction per N m of the gear's torque

  static constexpr bool varies = true, loaded = true, directed = false;
  constexpr Friction linear() const { return {Dv, Dc, Ds}; }

  constexpr bool is_dry() const { return Ds > 0.0 || mu > 0.0; }
  template <class X>
  ARM_INLINE constexpr X sliding_torque(X w, const ShaftTorques<X>& on) const {
    const X dry = vs > 0.0 ? Stribeck{Dv, Dc, Ds, vs}.sliding_torque(w, on) : X{} + Dc;
    return dry + mu * magnitude(on.of_gear);
  }
  template <class X>
  ARM_INLINE constexpr X holding_torque(const ShaftTorques<X>& on) const {
    return Ds + mu * magnitude(on.of_gear);
  }
};

// `square`: the exponent of the speed is 2.
template <bool square>
struct DirectedLoadFriction {
  constexpr bool operator==(const DirectedLoadFriction&) const = default;

  Real Dv = 0.0, Dc = 0.0, Ds = 0.0, vs = 0.0;  // as of LoadFriction
  Real mu, mu_back = mu;                        // where the motor drives, and where the link does
  Real nu = 0.0, nu_back = nu;                  // as these, of terms that fade
  Real m = 0.0, n = 0.0;                        // per N m of the motor's torque
  Real q = 0.0, q_back = 0.0;                   // 1/(N m)
  Real alpha = 2.0;

  static constexpr bool varies = true, loaded = true, directed = true;
  constexpr Friction linear() const { return {Dv, Dc, Ds}; }

  constexpr bool is_dry() const {
    return Ds > 0.0 || mu > 0.0 || mu_back > 0.0 || m > 0.0 || nu > 0.0 || nu_back > 0.0 ||
           n > 0.0 || has_jump();
  }
  // Whether the torque jumps where those of motor and gear become equal.
  constexpr bool has_jump() const { return q > 0.0 || q_back > 0.0; }
  template <class X>
  ARM_INLINE constexpr X sliding_torque(X w, const ShaftTorques<X>& on) const {
    return Dc + load_torque(on, mu, mu_back, m) + fade_factor(w) * breakaway_terms(on);
  }
  template <class X>
  ARM_INLINE constexpr X holding_torque(const ShaftTorques<X>& on) const {
    return Dc + load_torque(on, mu, mu_back, m) + breakaway_terms(on);
  }

 private:
  template <class X>
  ARM_INLINE static constexpr X load_torque(const ShaftTorques<X>& on, Real drives, Real driven,
                                            Real of_motor) {
    return magnitude(of_motor * on.of_motor +
                     select(on.of_gear > 0.0, X{} + drives, X{} + driven) * on.of_gear);
  }
  template <class X>
  ARM_INLINE constexpr X breakaway_terms(const ShaftTorques<X>& on) const {
    const X squared = select(on.power_direction > 0.0, q * on.of_gear * on.of_gear,
                             q_back * on.of_motor * on.of_motor);
    return Ds - Dc + load_torque(on, nu, nu_back, n) +
           select(on.of_motor * on.of_gear > 0.0, squared, X{});
  }
  // The share of the fading terms that remains at the speed w.
  template <class X>
  ARM_INLINE constexpr X fade_factor(X w) const {
    if (!(vs > 0.0)) return X{};
    X share{};
    for (int lane = 0; lane < kWidth<X>; ++lane)
      set_lane(share, lane, fade_factor_at(magnitude(lane_of(w, lane)) / vs));
    return share;
  }
  // Nothing where it is below rounding: e^-37 and less, for which most speeds need no functions.
  ARM_INLINE constexpr Real fade_factor_at(const Real& ratio) const {
    if constexpr (square) {
      return ratio > 6.1 ? Real{0.0} : exponential(-ratio * ratio);
    } else {
      if (ratio > (alpha >= 2.0 ? 6.1 : alpha >= 1.0 ? 37.0 : 1400.0)) return 0.0;
      return ratio > 0.0 ? exponential(-power(ratio, alpha)) : Real{1.0};
    }
  }
};

}  // namespace arm
