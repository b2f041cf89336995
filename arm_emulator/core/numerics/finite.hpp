// Test for finite numbers by bit patterns, since scenes are compiled for finite arithmetic, where
// comparisons with NaN are undefined.
#pragma once

#include <bit>
#include <cstdint>

#include "numerics/number.hpp"

namespace arm {

inline constexpr std::int64_t kExponent = 0x7ff0000000000000;

// Under these flags a compiler may assume that no number is infinite or NaN. It may fold tests of
// bits whose computation it sees (clang does since version 18). This function hides a number from
// the compiler.
template <class Bits>
ARM_INLINE Bits unforeseen(Bits bits) {
#if defined(__CUDA__)
  // A card's registers hold no lanes.
  if constexpr (std::is_arithmetic_v<Bits>)
    asm("" : "+l"(bits));
  else
    for (unsigned lane = 0; lane < sizeof bits / sizeof bits[0]; ++lane)
      bits[lane] = unforeseen(bits[lane]);
  return bits;
#else
  if constexpr (std::is_arithmetic_v<Bits>) asm("" : "+r"(bits));
#if defined(__AVX512F__)
  else if constexpr (sizeof bits == kNativeLanes * sizeof(double))
    asm("" : "+v"(bits));
#elif defined(__SSE2__)
  else if constexpr (sizeof bits == kNativeLanes * sizeof(double))
    asm("" : "+x"(bits));
#endif
  else
    asm("" : "+m"(bits));  // lanes, for which one register need not be enough
  return bits;
#endif
}

ARM_INLINE bool is_finite(double x) {
  return (unforeseen(std::bit_cast<std::int64_t>(x)) & kExponent) != kExponent;
}

template <int directions>
ARM_INLINE bool is_finite(const Dual<directions>& x) {
  return is_finite(x.value);
}

// Whether each lane is finite.
template <class X>
  requires(kWidth<X> > 1)
ARM_INLINE Mask<X> is_finite(const X& x) {
  return (unforeseen(std::bit_cast<Mask<X>>(x)) & kExponent) != kExponent;
}

// NaN: for what has no value.
ARM_INLINE double no_number() { return std::bit_cast<double>(unforeseen(0x7ff8000000000000)); }

}  // namespace arm
