// Counter-based random numbers: each is a function of seed, stream and index. There is no state to
// save, and no dependence on other draws.
#pragma once

#include <bit>
#include <cstdint>

#include "numerics/exponential.hpp"
#include "numerics/sincos.hpp"

namespace arm {

// A word of which each bit depends on all bits of x (Steele, Lea and Flood 2014, SplitMix64).
constexpr std::uint64_t mix_bits(std::uint64_t x) {
  x = (x ^ (x >> 30)) * 0xbf58476d1ce4e5b9;
  x = (x ^ (x >> 27)) * 0x94d049bb133111eb;
  return x ^ (x >> 31);
}
inline constexpr std::uint64_t kGolden = 0x9e3779b97f4a7c15;  // 2^64 over the golden ratio

// A stream of draws. `number`: index of the draw, from 0.
struct Noise {
  std::uint64_t key;

  static constexpr Noise make_stream(double seed, int who) {
    return {mix_bits(mix_bits(std::bit_cast<std::uint64_t>(seed) + kGolden) +
                     kGolden * static_cast<std::uint64_t>(who + 1))};
  }

  // Uniform, above 0 and at most 1.
  double uniform(std::int64_t number) const {
    const std::uint64_t word = mix_bits(key + kGolden * static_cast<std::uint64_t>(number));
    return static_cast<double>((word >> 11) + 1) * 0x1p-53;
  }
  // A draw of the exponential distribution, of mean 1.
  double exponential(std::int64_t number) const { return -logarithm(uniform(number)); }
  // A draw of the normal distribution, of mean 0 and variance 1 (Box and Muller 1958).
  ARM_APART double normal(std::int64_t number) const {
    const double r = __builtin_sqrt(2.0 * exponential(2 * number));
    return r * sincos(6.283185307179586 * uniform(2 * number + 1)).cos;
  }
};

// Whether the sample of that number repeats the previous reading; its draws are independent of all
// others.
inline bool repeats_reading(double probability, const Noise& noises, std::int64_t number) {
  return probability > 0.0 && Noise{mix_bits(noises.key + 1)}.uniform(number) <= probability;
}

}  // namespace arm
