// One wave of what goes with the angle of a shaft: amplitude sin(k angle + phase).
#pragma once

#include "numerics/sincos.hpp"

namespace arm {

struct Harmonic {
  double k;          // waves per turn
  double amplitude;  // of the quantity of the part
  double phase;      // rad

  // Its sine and cosine at an angle, times the amplitude. What is worked out while a scene is
  // compiled is the machine at rest, where no wave matters.
  template <class X>
  ARM_INLINE constexpr SinCos<X> at(const X& angle) const {
    if (__builtin_is_constant_evaluated()) return {X{}, X{}};
    const auto wave = sincos(X(k * angle + phase));
    return {amplitude * wave.sin, amplitude * wave.cos};
  }
};

}  // namespace arm
