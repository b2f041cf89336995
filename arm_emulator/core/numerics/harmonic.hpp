// One wave over the angle of a shaft: amplitude sin(k angle + phase).
#pragma once

#include "numerics/sincos.hpp"

namespace arm {

struct Harmonic {
  constexpr bool operator==(const Harmonic&) const = default;

  Real k;          // waves per turn
  Real amplitude;  // of the quantity of the part
  Real phase;      // rad

  // Its sine and cosine at an angle, times the amplitude. Compile-time evaluation is only of the
  // machine at rest, where waves do not matter.
  template <class X>
  ARM_INLINE constexpr SinCos<X> at(const X& angle) const {
    if (__builtin_is_constant_evaluated()) return {X{}, X{}};
    const auto wave = sincos(X(k * angle + phase));
    return {amplitude * wave.sin, amplitude * wave.cos};
  }
};

}  // namespace arm
