// Whether a number is one. Reads bit patterns, since a scene's unit is compiled for finite
// arithmetic and may take a comparison with NaN as it likes.
#pragma once

#include <bit>
#include <cstdint>

#include "number.hpp"

namespace arm {

inline constexpr std::int64_t kExponent = 0x7ff0000000000000;

ARM_INLINE bool is_finite(double x) {
  return (std::bit_cast<std::int64_t>(x) & kExponent) != kExponent;
}

// Of each lane.
template <class X>
  requires(kWidth<X> > 1)
ARM_INLINE Mask<X> is_finite(const X& x) {
  return (std::bit_cast<Mask<X>>(x) & kExponent) != kExponent;
}

}  // namespace arm
