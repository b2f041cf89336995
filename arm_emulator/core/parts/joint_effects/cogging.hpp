// Cogging of a motor: magnets attracted by the teeth of the stator, with or without current.
//
//   torque on the rotor  -sum a sin(k tm + phi)      stored  sum a / k (1 - cos(k tm + phi))
#pragma once

#include <array>

#include "numerics/harmonic.hpp"
#include "parts/joint_effects/no_torque.hpp"

namespace arm {

template <int n>
struct Cogging : NoTorque<Place::rotor> {
  constexpr bool operator==(const Cogging&) const = default;

  std::array<Harmonic, n> waves;  // N m

  template <class X>
  ARM_INLINE constexpr X torque(X tm, X, const X*, X, bool) const {
    X sum{};
    for (const Harmonic& one : waves) sum -= one.at(tm).sin;
    return sum;
  }
  template <class X>
  ARM_INLINE constexpr X stored_energy(X tm, const X*) const {
    X sum{};
    for (const Harmonic& one : waves) {
      const Real size = one.amplitude < 0.0 ? -one.amplitude : one.amplitude;
      sum += (size - one.at(tm).cos) / one.k;
    }
    return sum;
  }
};

}  // namespace arm
