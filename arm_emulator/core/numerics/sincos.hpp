// Sine and cosine of joint angles, inline so that the compiler can work on several joints at once.
// No function of the system's library is called, whose rounding differs between systems.
#pragma once

#include <bit>
#include <cstdint>

#include "numerics/fma.hpp"

namespace arm {

template <class X>
struct SinCos {
  X sin, cos;
};

__extension__ typedef unsigned __int128 Wide;
__extension__ typedef __int128 SignedWide;

inline constexpr double kReducible = 1e5;  // rad; up to here n below has at most 17 bits

// A number between -pi/4 and pi/4 that differs from an angle by `quadrant` right angles.
template <class X>
struct Reduced {
  X angle;
  Mask<X> quadrant;  // whole, of which the last two bits count
};
template <>
struct Reduced<double> {
  double angle;
  std::int64_t quadrant;
};

// By Cody and Waite (1980): x - n pi/2, with pi/2 in three parts. The first difference is exact, as
// a multiple of 2^-53 below 1.
template <class X>
ARM_INLINE Reduced<X> reduce_angle(const X& x) {
  const X shifted = fma(x, 0.63661977236758134308, kOnes);
  const X n = kOnes - shifted;
  const X first_difference = fma(n, 0x1.921fb54442d18p+0, x);
  return {fma(n, -0x1.f1976b7ed8fbcp-110, fma(n, 0x1.1a62633145c07p-54, first_difference)),
          std::bit_cast<decltype(Reduced<X>::quadrant)>(shifted)};
}

// The first 1216 bits of 2/pi behind the point, after 64 zeros.
inline constexpr std::uint64_t kTwoOverPi[] = {
    0x0000000000000000, 0xa2f9836e4e441529, 0xfc2757d1f534ddc0, 0xdb6295993c439041,
    0xfe5163abdebbc561, 0xb7246e3a424dd2e0, 0x06492eea09d1921c, 0xfe1deb1cb129a73e,
    0xe88235f52ebb4484, 0xe99c7026b45f7e41, 0x3991d639835339f4, 0x9c845f8bbdf9283b,
    0x1ff897ffde05980f, 0xef2f118b5a0a6d1f, 0x6d367ecf27cb09b7, 0x4f463f669e5fea2d,
    0x7527bac7ebe5f17b, 0x3d0739f78a5292ea, 0x6bfb5fb11f8d5d08, 0x56033046fc7b6bab};

// Whole numbers of 128 bits as the nearest double, and doubles without a fraction as such numbers:
// cards have no conversions of them.
ARM_ONCE inline double nearest_double(SignedWide integer) {
  const Wide size = integer < 0 ? -static_cast<Wide>(integer) : static_cast<Wide>(integer);
  int shift = 0;  // up to the upper half alone is left
  while (size >> shift >> 64) ++shift;
  // The lowest bit stands for all that are lost: the sum is rounded once.
  const std::uint64_t bits =
      static_cast<std::uint64_t>(size >> shift) | (size != size >> shift << shift);
  const double scale = std::bit_cast<double>(static_cast<std::int64_t>(1023 + shift) << 52);
  const double result = static_cast<double>(bits) * scale;
  return integer < 0 ? -result : result;
}
ARM_ONCE inline SignedWide whole_number(double x) {
  const std::uint64_t bits = std::bit_cast<std::uint64_t>(x);
  const Wide m = (bits & 0xfffffffffffff) | 0x10000000000000;
  const int shift = static_cast<int>(bits >> 52 & 0x7ff) - 1075;
  const Wide size = shift >= 0 ? m << shift : shift > -53 ? m >> -shift : 0;
  return static_cast<SignedWide>(bits >> 63 ? -size : size);
}

// By Payne and Hanek (1983), for any finite angle: x 2/pi modulo 4 in whole numbers, without those
// bits of 2/pi whose product with x is a multiple of 4.
ARM_ONCE inline Reduced<double> reduced_anywhere(double x) {
  const std::uint64_t bits = std::bit_cast<std::uint64_t>(x);
  const std::uint64_t m = (bits & 0xfffffffffffff) | 0x10000000000000;
  const int from = static_cast<int>(bits >> 52 & 0x7ff) - 1075 + 62;  // of |x| = m 2^(from - 62)
  const int word = from / 64, shift = from % 64;
  std::uint64_t window[3];
  for (int k = 0; k < 3; ++k)
    window[k] =
        kTwoOverPi[word + k] << shift | (shift > 0 ? kTwoOverPi[word + k + 1] >> (64 - shift) : 0);
  const Wide low = Wide{m} * window[2], middle = Wide{m} * window[1] + (low >> 64);
  const std::uint64_t high = m * window[0] + static_cast<std::uint64_t>(middle >> 64);
  // Right angles: two bits before the point, then a fraction between -1/2 and 1/2.
  const Wide right_angles = Wide{high} << 64 | static_cast<std::uint64_t>(middle);
  const auto fraction = static_cast<SignedWide>(right_angles << 2 | (low >> 62 & 3));
  const std::int64_t quadrant = static_cast<std::int64_t>(right_angles >> 126) + (fraction < 0);
  const double leading = nearest_double(fraction);
  const double trailing = nearest_double(fraction - whole_number(leading));
  const double angle = 0x1p-128 * (leading * 1.5707963267948966 + (leading * 6.123233995736766e-17 +
                                                                   trailing * 1.5707963267948966));
  return x < 0.0 ? Reduced<double>{-angle, -quadrant} : Reduced<double>{angle, quadrant};
}

// Minimax polynomials on [-pi/4, pi/4] with the coefficients of fdlibm (k_sin.c, k_cos.c).
template <class X>
ARM_INLINE SinCos<X> sincos_of(const Reduced<X>& reduced) {
  const X &r = reduced.angle, z = r * r, z_2 = z * z;
  const auto pair = [&z](double constant, double factor) { return fma(z, factor, constant); };
  const X of_s = fma(z_2, pair(-2.50507602534068634195e-08, 1.58969099521155010221e-10),
                     pair(-1.98412698298579493134e-04, 2.75573137070700676789e-06));
  const X s =
      fma(r * z, fma(z_2, of_s, pair(-1.66666666666666324348e-01, 8.33333333332248946124e-03)), r);
  const X of_c = fma(z_2, pair(-2.08757232129817482790e-09, 1.13596475577881948265e-11),
                     pair(-2.48015872894767294178e-05, 2.75573143513906633035e-07));
  const X c =
      1.0 - fma(z_2, fma(z_2, of_c, pair(-4.16666666666666019037e-02, 1.38888888888741095749e-03)),
                0.5 * z);
  const auto quadrant = reduced.quadrant;
  const auto odd = (quadrant & 1) != 0;
  const X sin_r = select(odd, c, s);
  const X cos_r = select(odd, s, c);
  return {select((quadrant & 2) != 0, X(-sin_r), sin_r),
          select(((quadrant + 1) & 2) != 0, X(-cos_r), cos_r)};
}

// Sine and cosine in each lane, one by one where the angle is too large for `reduced`.
template <class X>
__attribute__((noinline)) SinCos<X> sincos_anywhere(const X& x) {
  SinCos<X> result = sincos_of(reduce_angle(x));
  for (int lane = 0; lane < kWidth<X>; ++lane) {
    if (magnitude(lane_of(x, lane)) < kReducible) continue;
    const auto lane_schedule = sincos_of(reduced_anywhere(lane_of(x, lane)));
    set_lane(result.sin, lane, lane_schedule.sin);
    set_lane(result.cos, lane, lane_schedule.cos);
  }
  return result;
}

// Within 1.5 ulp of the exact values, beyond kReducible within 2.5 ulp.
template <class X>
ARM_INLINE SinCos<X> sincos(const X& x) {
  if (__builtin_expect(!any(magnitude(x) >= kReducible), 1)) return sincos_of(reduce_angle(x));
  return sincos_anywhere(x);
}

template <int directions>
ARM_INLINE SinCos<Dual<directions>> sincos(const Dual<directions>& x) {
  const auto [sin, cos] = sincos(x.value);
  return {chained(sin, cos, x), chained(cos, -sin, x)};
}

}  // namespace arm
