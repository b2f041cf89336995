// Fused products, stated where they save time. A compiler fuses none by itself, so that every
// processor gives the same bits.
#pragma once

#include "numerics/number.hpp"

namespace arm {

// a b + c, rounded once; in constants of a scene twice, since clang has no fused product there.
ARM_INLINE constexpr double fused(double a, double b, double c) {
  return __builtin_is_constant_evaluated() ? a * b + c : __builtin_fma(a, b, c);
}
// a b + c in lanes. GCC makes no instruction of a loop over lanes, if much is inlined around it.
template <class X>
  requires(kWidth<X> > 1)
ARM_INLINE X fused(const X& a, const X& b, const X& c) {
#if !defined(__clang__) && defined(__AVX512F__)
  if constexpr (kWidth<X> == 8) return __builtin_ia32_vfmaddpd512_mask(a, b, c, -1, 4);
#endif
#if !defined(__clang__) && defined(__FMA__)
  if constexpr (kWidth<X> == 4) return __builtin_ia32_vfmaddpd256(a, b, c);
  if constexpr (kWidth<X> == 2) return __builtin_ia32_vfmaddpd(a, b, c);
#elif !defined(__clang__) && defined(__aarch64__)
  if constexpr (kWidth<X> == 2) return __builtin_aarch64_fmav2df(a, b, c);
#endif
  X sum;
  for (int lane = 0; lane < kWidth<X>; ++lane) sum[lane] = __builtin_fma(a[lane], b[lane], c[lane]);
  return sum;
}

// a b + c of numbers and lanes, rounded once. Numbers with derivatives are rounded twice.
template <class A, class B, class C>
ARM_INLINE constexpr auto fma(const A& a, const B& b, const C& c) {
  using X = decltype(a * b + c);
  if constexpr (kDifferentiates && !std::is_same_v<X, double>)
    return a * b + c;
  else
    return fused(X{} + a, X{} + b, X{} + c);
}

// a b + c where constants of a scene are often 0, whose products are left out: GCC leaves out no
// fused product by itself. Bits do not depend on what it knows; lanes have their constants in
// common.
template <class A, class B, class C>
ARM_INLINE constexpr auto sparse_fma(const A& a, const B& b, const C& c) {
  using X = decltype(a * b + c);
#ifndef __clang__
  if constexpr (!kDifferentiates || std::is_same_v<X, double>) {
    const auto product = a * b;
    if (__builtin_constant_p(product) & (lane_of(product, 0) == 0.0)) return X{} + c;
  }
#endif
  return X{} + fma(a, b, c);
}

}  // namespace arm
