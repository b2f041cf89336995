// Loops over joints: unrolled at compile time for the usual arm, so that a joint's constants fold.
#pragma once

// Its vectors of joined sums and differences have fused products, whatever -ffp-contract asks for.
#if defined(__GNUC__) && !defined(__clang__) && __GNUC__ == 12 && __GNUC_MINOR__ < 3
#pragma GCC optimize("no-tree-slp-vectorize")
#endif

#include <type_traits>
#include <utility>

namespace arm {

// Above this count unrolling costs more (compile time, instruction cache) than folding saves.
inline constexpr int kUnrollLimit = 24;
// The limit of loops with long loops inside.
inline constexpr int kUnrollNested = 12;

#define ARM_INLINE __attribute__((always_inline)) inline

// Neither inlined nor cloned (which clang never does): every caller runs the same instructions and
// gets the same bits.
#if defined(__clang__)
#define ARM_APART __attribute__((noinline))
#else
#define ARM_APART __attribute__((noinline, noclone))
#endif

// Inlined on processors. A card's assembler takes more than linear time for long functions.
#ifdef __CUDA__
#define ARM_INLINE_ON_HOST ARM_APART
#else
#define ARM_INLINE_ON_HOST ARM_INLINE
#endif

// For code outside of steps: compiled for size, and once, not for each joint with its constants, to
// save compile time.
#define ARM_ONCE __attribute__((cold)) ARM_APART

// body(i) for i = first, first + step, ...: unrolled. Not by a function in a function: a compiler
// optimises each of them once more.
template <class Counts, int first, int step>
struct Unrolled;
template <int... count, int first, int step>
struct Unrolled<std::integer_sequence<int, count...>, first, step> {
  template <class Body>
  ARM_INLINE static void run(Body&& body) {
    (body(std::integral_constant<int, first + step * count>{}), ...);
  }
};
template <int N, int first = 0, int step = 1>
using Unroll = Unrolled<std::make_integer_sequence<int, N>, first, step>;

// body(i) for i = 0 .. N-1; `i` converts to int and, when unrolled, is a compile-time constant.
template <int N, int limit = kUnrollLimit, class Body>
ARM_INLINE void for_each(Body&& body) {
  if constexpr (N <= limit)
    Unroll<N>::run(body);
  else
    for (int i = 0; i < N; ++i) body(i);
}

// Above it the inner loops run over whole groups of this size.
inline constexpr int kLanes = 8;
template <int N>
inline constexpr int kPadded = N <= kUnrollNested ? N : (N + kLanes - 1) / kLanes * kLanes;
// The first of the group of j.
template <int N>
constexpr int first_lane(int j) {
  return N <= kUnrollNested ? j : j / kLanes * kLanes;
}

// body(i) for i = N-1 .. 0.
template <int N, int limit = kUnrollLimit, class Body>
ARM_INLINE void for_each_reverse(Body&& body) {
  if constexpr (N <= limit)
    Unroll<N, N - 1, -1>::run(body);
  else
    for (int i = N - 1; i >= 0; --i) body(i);
}

// The index after j, as constant as j is.
template <class Index>
ARM_INLINE constexpr auto next(Index j) {
  if constexpr (std::is_same_v<Index, int>)
    return j + 1;
  else
    return std::integral_constant<int, Index::value + 1>{};
}

// The index before i, or 0.
template <class Index>
ARM_INLINE constexpr auto before(Index i) {
  if constexpr (std::is_same_v<Index, int>)
    return i > 0 ? i - 1 : 0;
  else
    return std::integral_constant<int, (Index::value > 0 ? Index::value - 1 : 0)>{};
}

// body(j) for j = first .. N-1, with the constants of `first` kept.
template <int N, class Index, class Body>
ARM_INLINE void for_each_from(Index first, Body&& body) {
  if constexpr (std::is_same_v<Index, int>)
    for (int j = first; j < N; ++j) body(j);
  else
    Unroll<N - Index::value, Index::value>::run(body);
}

// body(j) in whole groups of lanes: beyond kUnrollNested also for some j before `first` and some
// from N to kPadded<N>, where there must be room.
template <int N, class Index, class Body>
ARM_INLINE void for_each_lane_from(Index first, Body&& body) {
  if constexpr (std::is_same_v<Index, int>) {
    for (int j = first_lane<N>(first); j < kPadded<N>; ++j) body(j);
  } else {
    for_each_from<N>(first, body);
  }
}

}  // namespace arm
