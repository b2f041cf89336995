// Sine and cosine of joint angles, inline so that the compiler can work on several joints at once.
#pragma once

#include "numerics/number.hpp"

namespace arm {

template <class X>
struct SinCos {
  X sin, cos;
};

#ifdef __FMA__
inline constexpr double kReducible = 1e5;  // rad; up to here the reduction has bits to spare
#else
inline constexpr double kReducible = -1.0;  // none is
#endif

#ifdef __FMA__

// a b + c, rounded once, and the whole number next to x. Both are safe from the reassociation that
// this unit is compiled with.
ARM_INLINE double fused(double a, double b, double c) { return __builtin_fma(a, b, c); }
ARM_INLINE double nearest(double x) { return __builtin_rint(x); }
ARM_INLINE long whole(double x) { return static_cast<long>(x); }

// In lanes, which are a register each; an empty instruction ends what may be reassociated.
template <class X>
ARM_INLINE X fused(const X& a, double b, const X& c) {
  X result = a * b + c;
  asm("" : "+x"(result));
  return result;
}
inline constexpr double kOnes = 0x1.8p52;  // added to a number, it makes the last bit worth 1
template <class X>
ARM_INLINE X nearest(const X& x) {
  X beside = x + kOnes;
  asm("" : "+x"(beside));
  return beside - kOnes;
}
template <class X>
ARM_INLINE Mask<X> whole(const X& x) {
  X beside = x + kOnes;
  asm("" : "+x"(beside));
  return __builtin_bit_cast(Mask<X>, beside);  // all but the first bits
}

// Within 1 ulp of the correctly rounded value up to kReducible.
template <class X>
ARM_INLINE SinCos<X> sincos_reduced(const X& x) {
  // Cody and Waite: x - n pi/2, with pi/2 in three parts.
  const X n = nearest(X(x * 0.63661977236758134308));
  X r = fused(X(-n), 1.5707963267948966, x);
  r = fused(X(-n), 6.123233995736766e-17, r);
  r = fused(X(-n), -1.4973849048591833e-33, r);
  const X z = r * r;
  // Minimax polynomials on [-pi/4, pi/4] with the coefficients of fdlibm (k_sin.c, k_cos.c).
  const X s =
      r + r * z *
              (-1.66666666666666324348e-01 +
               z * (8.33333333332248946124e-03 +
                    z * (-1.98412698298579493134e-04 +
                         z * (2.75573137070700676789e-06 + z * (-2.50507602534068634195e-08 +
                                                                z * 1.58969099521155010221e-10)))));
  const X c =
      1.0 - 0.5 * z +
      z * z *
          (4.16666666666666019037e-02 +
           z * (-1.38888888888741095749e-03 +
                z * (2.48015872894767294178e-05 +
                     z * (-2.75573143513906633035e-07 +
                          z * (2.08757232129817482790e-09 + z * -1.13596475577881948265e-11)))));
  const auto quadrant = whole(n);
  const auto odd = (quadrant & 1) != 0;
  const X sin_r = select(odd, c, s);
  const X cos_r = select(odd, s, c);
  return {select((quadrant & 2) != 0, X(-sin_r), sin_r),
          select(((quadrant + 1) & 2) != 0, X(-cos_r), cos_r)};
}
#endif

// Of each lane, one by one where it is too large to be reduced.
template <class X>
__attribute__((noinline)) SinCos<X> sincos_anywhere(const X& x) {
#ifdef __FMA__
  SinCos<X> result = sincos_reduced(x);
#else
  SinCos<X> result;
#endif
  for (int lane = 0; lane < kWidth<X>; ++lane) {
    if (magnitude(lane_of(x, lane)) < kReducible) continue;
    set_lane(result.sin, lane, __builtin_sin(lane_of(x, lane)));
    set_lane(result.cos, lane, __builtin_cos(lane_of(x, lane)));
  }
  return result;
}

template <class X>
ARM_INLINE SinCos<X> sincos(const X& x) {
#ifdef __FMA__
  if (__builtin_expect(!any(magnitude(x) >= kReducible), 1)) return sincos_reduced(x);
#endif
  return sincos_anywhere(x);
}

template <int directions>
ARM_INLINE SinCos<Dual<directions>> sincos(const Dual<directions>& x) {
  const auto [sin, cos] = sincos(x.value);
  return {chained(sin, cos, x), chained(cos, -sin, x)};
}

}  // namespace arm
