// A bearing that gives way in one direction, as the drive of that deflection has it.
//
//   torque  -K q - D v      stored  K q^2 / 2      dissipated  D v^2
#pragma once

#include "numerics/number.hpp"
#include "parts/place.hpp"

namespace arm {

// It is stiff, so the schemes take it implicitly.
struct Bearing {
  constexpr bool operator==(const Bearing&) const = default;

  Real K;  // N m/rad (N/m)
  Real D;  // N m s/rad (N s/m)

  static constexpr Place place = Place::link;
  static constexpr int states = 0, modes = 0;
  constexpr const Bearing& linear() const { return *this; }

  template <class X>
  ARM_INLINE constexpr X torque(X q, X v, const X*, X, bool) const {
    return -K * q - D * v;
  }
  template <class X>
  ARM_INLINE constexpr X stored_energy(X q, const X*) const {
    return 0.5 * K * q * q;
  }
  constexpr Real dissipated_power(Real, Real v, const Real*, bool) const { return D * v * v; }
};

}  // namespace arm
