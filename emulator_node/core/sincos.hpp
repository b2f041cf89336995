// Sine and cosine of joint angles, inline so that the compiler can work on several joints at once.
#pragma once

#include <cmath>

#include "number.hpp"

namespace arm {

template <class X>
struct SinCos {
  X sin, cos;
};

#ifdef __FMA__
inline constexpr double kReducible = 1e5;  // rad; up to here the reduction has bits to spare

// Within 1 ulp of the correctly rounded value up to kReducible.
ARM_INLINE SinCos<double> sincos_reduced(double x) {
  // Cody and Waite: x - n pi/2, with pi/2 in three parts. The explicit fma is out of reach of the
  // reassociation that this unit is compiled with.
  const double n = __builtin_rint(x * 0.63661977236758134308);
  double r = __builtin_fma(-n, 1.5707963267948966, x);
  r = __builtin_fma(-n, 6.123233995736766e-17, r);
  r = __builtin_fma(-n, -1.4973849048591833e-33, r);
  const double z = r * r;
  // Minimax polynomials on [-pi/4, pi/4] with the coefficients of fdlibm (k_sin.c, k_cos.c).
  const double s =
      r + r * z *
              (-1.66666666666666324348e-01 +
               z * (8.33333333332248946124e-03 +
                    z * (-1.98412698298579493134e-04 +
                         z * (2.75573137070700676789e-06 + z * (-2.50507602534068634195e-08 +
                                                                z * 1.58969099521155010221e-10)))));
  const double c =
      1.0 - 0.5 * z +
      z * z *
          (4.16666666666666019037e-02 +
           z * (-1.38888888888741095749e-03 +
                z * (2.48015872894767294178e-05 +
                     z * (-2.75573143513906633035e-07 +
                          z * (2.08757232129817482790e-09 + z * -1.13596475577881948265e-11)))));
  const long quadrant = static_cast<long>(n);
  const double sin_r = quadrant & 1 ? c : s;
  const double cos_r = quadrant & 1 ? s : c;
  return {quadrant & 2 ? -sin_r : sin_r, (quadrant + 1) & 2 ? -cos_r : cos_r};
}
#endif

ARM_INLINE SinCos<double> sincos(double x) {
#ifdef __FMA__
  if (__builtin_expect(std::fabs(x) < kReducible, 1)) return sincos_reduced(x);
#endif
  return {std::sin(x), std::cos(x)};
}

// The same for each lane.
template <class X>
ARM_INLINE SinCos<X> sincos(const X& x) {
  SinCos<X> result;
#ifdef __FMA__
  if (__builtin_expect(!any(magnitude(x) >= kReducible), 1)) {
    for (int lane = 0; lane < kWidth<X>; ++lane) {
      const auto [sin, cos] = sincos_reduced(x[lane]);
      result.sin[lane] = sin, result.cos[lane] = cos;
    }
    return result;
  }
#endif
  for (int lane = 0; lane < kWidth<X>; ++lane) {
    result.sin[lane] = std::sin(x[lane]), result.cos[lane] = std::cos(x[lane]);
  }
  return result;
}

}  // namespace arm
