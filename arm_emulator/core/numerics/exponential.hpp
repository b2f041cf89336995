// Exponential function and natural logarithm. They are the core's own, since libraries of systems
// round differently.
#pragma once

#include <bit>
#include <cstdint>

#include "numerics/number.hpp"

namespace arm {

// e^x within 1 ulp, 0 below -708: x = n ln 2 + r, and e^r by the rational function of fdlibm
// (e_exp.c).
constexpr double exponential(double x) {
  if (x < -708.0) return 0.0;
  const double shifted = x * 1.44269504088896338700 + kOnes;
  const double n = shifted - kOnes;
  const double high = x - n * 6.93147180369123816490e-01;
  const double low = n * 1.90821492927058770002e-10;
  const double r = high - low, z = r * r;
  const double c =
      r - z * (1.66666666666666019037e-01 +
               z * (-2.77777777770155933842e-03 +
                    z * (6.61375632143793436117e-05 +
                         z * (-1.65339022054652515390e-06 + z * 4.13813679705723846039e-08))));
  const double y = 1.0 - ((low - r * c / (2.0 - c)) - high);
  const std::int64_t exponent = static_cast<std::int64_t>(n) + 1023;
  return y * std::bit_cast<double>(exponent << 52);
}

template <class X>
  requires(kWidth<X> > 1)
ARM_INLINE X exponential(X x) {
  for (int lane = 0; lane < kWidth<X>; ++lane) x[lane] = exponential(double{x[lane]});
  return x;
}

// The series of artanh, exact to some 1e-16 for |s| < 0.18 and to some 1e-12 for |s| < 1/3.
constexpr double artanh(double s) {
  const double z = s * s;
  double sum = 0.0;
  for (int k = 21; k >= 1; k -= 2) sum = 1.0 / k + z * sum;
  return s * sum;
}

// Natural logarithm of 0 < x < inf, x = 2^n m with m within a factor of sqrt(2) of 1.
constexpr double logarithm(double x) {
  const std::uint64_t bits = std::bit_cast<std::uint64_t>(x);
  std::int64_t n = static_cast<std::int64_t>(bits >> 52) - 1023;
  double m = std::bit_cast<double>((bits & 0xfffffffffffff) | 0x3ff0000000000000);
  if (m > 1.4142135623730951) m *= 0.5, ++n;
  return static_cast<double>(n) * 0.69314718055994531 + 2.0 * artanh((m - 1.0) / (m + 1.0));
}

// x^a of 0 < x < inf within 1e-13 for results below 1e16, 0 below 1e-304: e^(a ln x) by series
// whose terms do not wait for each other.
constexpr double power(double x, double a) {
  const std::uint64_t bits = std::bit_cast<std::uint64_t>(x);
  std::int64_t n = static_cast<std::int64_t>(bits >> 52) - 1023;
  double m = std::bit_cast<double>((bits & 0xfffffffffffff) | 0x3ff0000000000000);
  if (m > 1.4142135623730951) m *= 0.5, ++n;
  const double s = (m - 1.0) / (m + 1.0), z = s * s, z2 = z * z, z4 = z2 * z2;
  const double artanh_of_s =
      s * (((1.0 + z * (1.0 / 3.0)) + z2 * (0.2 + z * (1.0 / 7.0))) +
           z4 * (((1.0 / 9.0 + z * (1.0 / 11.0)) + z2 * (1.0 / 13.0 + z * (1.0 / 15.0))) +
                 z4 * ((1.0 / 17.0 + z * (1.0 / 19.0)) + z2 * (1.0 / 21.0))));
  const double y = a * (static_cast<double>(n) * 0.69314718055994531 + 2.0 * artanh_of_s);
  if (y < -700.0) return 0.0;
  const double integer = (y * 1.44269504088896338700 + kOnes) - kOnes;
  const double r = y - integer * 0.69314718055994531, r2 = r * r, r4 = r2 * r2;
  const double e =
      ((1.0 + r) + r2 * (1.0 / 2.0 + r * (1.0 / 6.0))) +
      r4 * (((1.0 / 24.0 + r * (1.0 / 120.0)) + r2 * (1.0 / 720.0 + r * (1.0 / 5040.0))) +
            r4 * (((1.0 / 40320.0 + r * (1.0 / 362880.0)) +
                   r2 * (1.0 / 3628800.0 + r * (1.0 / 39916800.0))) +
                  r4 * (1.0 / 479001600.0 + r * (1.0 / 6227020800.0))));
  return e * std::bit_cast<double>((static_cast<std::int64_t>(integer) + 1023) << 52);
}

template <int directions>
ARM_INLINE constexpr Dual<directions> exponential(const Dual<directions>& x) {
  const double e = exponential(x.value);
  return chained(e, e, x);
}

template <int directions>
ARM_INLINE constexpr Dual<directions> logarithm(const Dual<directions>& x) {
  return chained(logarithm(x.value), 1.0 / x.value, x);
}

template <int directions>
ARM_INLINE constexpr Dual<directions> power(const Dual<directions>& x, const Dual<directions>& a) {
  const double p = power(x.value, a.value);
  return {p, p * (a.value / x.value * x.by + logarithm(x.value) * a.by)};
}

}  // namespace arm
