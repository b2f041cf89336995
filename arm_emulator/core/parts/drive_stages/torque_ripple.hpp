// Torque ripple: the torque per current varies with the angle of the rotor, by the factor
//
//   s = 1 + sum a sin(k tm + phi)
//
// Torque s Kt i and induced voltage s Kb wm have the same factor, so that no power is lost: the
// motor's equations are those at the rotor speed s wm.
#pragma once

#include <array>

#include "numerics/harmonic.hpp"

namespace arm {

template <class Motor, int n>
struct RippledMotor : Motor {
  // g++ 11 leaves the base out of a defaulted comparison.
  constexpr bool operator==(const RippledMotor& other) const {
    return Motor::operator==(other) && waves == other.waves;
  }

  std::array<Harmonic, n> waves;  // of 1

  constexpr decltype(auto) linear() const { return Motor::linear(); }

  template <class X>
  ARM_INLINE constexpr X ripple(X tm) const {
    X s = X{} + 1.0;
    for (const Harmonic& one : waves) s += one.at(tm).sin;
    return s;
  }
  template <class X>
  ARM_INLINE constexpr X torque(const X* z, X tm) const {
    return ripple(tm) * Motor::torque(z, tm);
  }
};

}  // namespace arm
