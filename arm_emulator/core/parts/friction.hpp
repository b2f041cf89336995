// Friction of a shaft, of a rotor or of a link: viscous, and Coulomb's.
//
// A shaft that turns feels -Dv w - Dc sign(w). One at rest is held while the torque on it is at
// most Ds >= Dc: it stays at rest exactly, without regularisation and at any step size. Of a link
// see coulomb.hpp, which solves for all links at once; of a rotor rotor_friction.hpp.
#pragma once

#include "numerics/number.hpp"

namespace arm {

struct Friction {
  double Dv = 0.0;            // N m s/rad, viscous
  double Dc = 0.0, Ds = 0.0;  // N m, while the shaft slides, and what holds it at rest

  // Whether the torque of sliding depends on anything. Then it is taken at a step's start, and how
  // it changes enters the second stage.
  static constexpr bool varies = false;
  // Whether what holds a shaft goes with the torque of the gear.
  static constexpr bool loaded = false;

  // See drive.hpp.
  constexpr const Friction& linear() const { return *this; }

  // Whether it can hold a shaft at rest. The holding torque at an instant may still be 0.
  constexpr bool is_dry() const { return Dc > 0.0; }
  // Torques against sliding at the speed w, and that hold at rest, under the torque T of the gear
  // on that shaft.
  template <class X>
  ARM_INLINE constexpr X sliding(X, X) const {
    return X{} + Dc;
  }
  template <class X>
  ARM_INLINE constexpr X holding(X) const {
    return X{} + Ds;
  }
};

}  // namespace arm
