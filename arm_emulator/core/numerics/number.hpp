// The number types of the core: Real (real.hpp), and lanes, which are several machines next to each
// other in one vector register. Branches on data are written as `select`, since lanes may differ.
#pragma once

#include <type_traits>

#include "numerics/real.hpp"

namespace arm {

template <int width>
struct LanesOf {
  typedef double type __attribute__((vector_size(width * sizeof(double))));
  // Lanes in memory that has only the alignment of its numbers.
  typedef double Loose
      __attribute__((vector_size(width * sizeof(double)), aligned(sizeof(double)), may_alias));

  ARM_INLINE static type load(const double* numbers) {
    return *reinterpret_cast<const Loose*>(numbers);
  }
  ARM_INLINE static void store(double* numbers, const type& vector) {
    *reinterpret_cast<Loose*>(numbers) = vector;
  }
};
template <int width>
using Lanes = typename LanesOf<width>::type;

template <class X>
inline constexpr int kWidth = sizeof(X) / sizeof(double);
template <int directions>
inline constexpr int kWidth<Dual<directions>> = 1;

// As many lanes as a vector register of this processor has, or as a thread of a card advances.
#if defined(ARM_LANES)
inline constexpr int kNativeLanes = ARM_LANES;
#elif defined(__AVX512F__)
inline constexpr int kNativeLanes = 8;
#elif defined(__AVX__)
inline constexpr int kNativeLanes = 4;
#else
inline constexpr int kNativeLanes = 2;
#endif

// The result of a comparison: a bool, or one per lane.
template <class X>
using Mask = decltype(X{} < X{});

// A bit for each lane of a mask, by its sign: in one instruction where a mask fills a register.
template <class M>
ARM_INLINE unsigned bits_of(const M& mask) {
#if defined(__AVX512DQ__)
  typedef long long Whole __attribute__((vector_size(64)));
  if constexpr (sizeof(M) == sizeof(Whole)) return __builtin_ia32_cvtq2mask512((Whole)mask);
#elif defined(__AVX__)
  typedef double Whole __attribute__((vector_size(32)));
  if constexpr (sizeof(M) == sizeof(Whole))
    return static_cast<unsigned>(__builtin_ia32_movmskpd256((Whole)mask));
#endif
  unsigned bits = 0;
  for (unsigned lane = 0; lane < sizeof(M) / sizeof(mask[0]); ++lane)
    bits |= static_cast<unsigned>(mask[lane] != 0) << lane;
  return bits;
}

ARM_INLINE constexpr bool any(bool mask) { return mask; }
template <class M>
  requires(!std::is_arithmetic_v<M>)
ARM_INLINE bool any(const M& mask) {
  return bits_of(mask) != 0;
}

// Whether it holds in every lane.
ARM_INLINE constexpr bool all(bool mask) { return mask; }
template <class M>
  requires(!std::is_arithmetic_v<M>)
ARM_INLINE bool all(const M& mask) {
  return bits_of(mask) == (1u << sizeof(M) / sizeof(mask[0])) - 1;
}

// A mask, combined with a condition that all lanes share.
ARM_INLINE constexpr bool where(bool condition, bool mask) { return condition && mask; }
template <class M>
  requires(!std::is_arithmetic_v<M>)
ARM_INLINE M where(bool condition, const M& mask) {
  return condition ? mask : M{};
}
template <class M>
  requires(!std::is_arithmetic_v<M>)
ARM_INLINE M where(const M& condition, const M& mask) {
  return condition & mask;
}

// `a` where the mask holds, else `b`.
ARM_INLINE constexpr double select(bool mask, double a, double b) { return mask ? a : b; }
template <class M, class A, class B>
  requires(!std::is_arithmetic_v<M>)
ARM_INLINE auto select(const M& mask, const A& a, const B& b) {
  using X = Lanes<sizeof(M) / sizeof(mask[0])>;
  return mask ? X{} + a : X{} + b;
}

template <class X>
ARM_INLINE constexpr X magnitude(X x) {
  return select(x < 0.0, -x, x);
}
// 1, or -1 of what is below 0.
template <class X>
ARM_INLINE constexpr X sign_of(X x) {
  return select(x < 0.0, X{} - 1.0, X{} + 1.0);
}
template <class X>
ARM_INLINE constexpr X clamp(X x, double limit) {
  return select(x > limit, X{} + limit, select(x < -limit, X{} - limit, x));
}
template <class X>
  requires(kWidth<X> > 1)
ARM_INLINE X clamp(const X& x, const X& limit) {
  return select(x > limit, limit, select(x < -limit, -limit, x));
}

ARM_INLINE double square_root(double x) { return __builtin_sqrt(x); }
template <class X>
  requires(kWidth<X> > 1)
ARM_INLINE X square_root(X x) {
  for (int lane = 0; lane < kWidth<X>; ++lane) x[lane] = __builtin_sqrt(x[lane]);
  return x;
}

// Added to a number, it makes the last bit worth 1: the sum is a whole number.
inline constexpr double kOnes = 0x1.8p52;

// The value of one lane.
ARM_INLINE constexpr double lane_of(double x, int) { return x; }
template <class X>
  requires(kWidth<X> > 1)
ARM_INLINE double lane_of(const X& x, int lane) {
  return x[lane];
}
ARM_INLINE constexpr void set_lane(double& x, int, double value) { x = value; }
template <class X>
  requires(kWidth<X> > 1)
ARM_INLINE void set_lane(X& x, int lane, double value) {
  x[lane] = value;
}

}  // namespace arm
