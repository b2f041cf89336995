// A number of each joint, side by side in vectors.
#pragma once

#include "numerics/number.hpp"

namespace arm {

// Quantities of drives are computed for all joints at once: a row of doubles is padded to whole
// vectors, without a remainder. Other numbers are vectors by themselves.
template <int N, class X>
inline constexpr int kGroup = !std::is_same_v<X, double> ? 1
                              : N <= 4                   ? 4
                                                         : 8;
template <int N, class X>
inline constexpr int kRow = (N + kGroup<N, X> - 1) / kGroup<N, X> * kGroup<N, X>;

// The joints' numbers in vectors. Arrays of them need no more alignment than their type states: a
// caller whose array is on the stack need not promise any.
template <int N, class X>
struct Row {
  // A vector fills a register: wider ones take a detour through memory.
  static constexpr int group = kGroup<N, X> < kNativeLanes ? kGroup<N, X> : kNativeLanes;
  static constexpr int groups = kRow<N, X> / group;
  using Vector = typename std::conditional_t<std::is_same_v<X, double>, LanesOf<group>,
                                             std::type_identity<X>>::type;
  Vector at[groups];

  ARM_INLINE static Row load(const X* numbers) {
    Row row;
    for_each<groups>([&](auto g)
                         __attribute__((always_inline)) { row.at[g] = load_group(numbers, g); });
    return row;
  }
  ARM_INLINE void store(X* numbers) const {
    for_each<groups>([&](auto g)
                         __attribute__((always_inline)) { store_group(numbers, g, at[g]); });
  }
  ARM_INLINE static Vector load_group(const X* numbers, int g) {
    if constexpr (group == 1)
      return numbers[g];
    else
      return LanesOf<group>::load(numbers + g * group);
  }
  ARM_INLINE static void store_group(X* numbers, int g, const Vector& vector) {
    if constexpr (group == 1)
      numbers[g] = vector;
    else
      LanesOf<group>::store(numbers + g * group, vector);
  }
  // From numbers computed one by one, without a round trip through memory.
  ARM_INLINE static Row gather(const X* numbers) {
    if constexpr (group == 1 || N > kUnrollLimit) {
      return load(numbers);
    } else {
      Row row;
      for_each<groups>([&](auto g) __attribute__((always_inline)) {
        row.at[g] = [&]<int... j>(std::integer_sequence<int, j...>) __attribute__((always_inline)) {
          return Vector{(g * group + j < N ? numbers[g * group + j] : 0.0)...};
        }(std::make_integer_sequence<int, group>{});
      });
      return row;
    }
  }
};

}  // namespace arm
