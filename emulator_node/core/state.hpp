// What the machine is at one instant.
#pragma once

#include "number.hpp"
#include "scene.hpp"

namespace arm {

// What the drives are asked for is worked out for all joints at once: a row of doubles is as long
// as whole vectors, with nothing at the end. Lanes are vectors by themselves.
template <int N, class X>
inline constexpr int kGroup = kWidth<X> > 1 ? 1
                              : N <= 4      ? 4
                                            : 8;
template <int N, class X>
inline constexpr int kRow = (N + kGroup<N, X> - 1) / kGroup<N, X> * kGroup<N, X>;

// The joints' numbers in vectors.
template <int N, class X>
struct Row {
  static constexpr int group = kGroup<N, X>, groups = kRow<N, X> / group;
  using Vector =
      typename std::conditional_t<(kWidth<X> > 1), std::type_identity<X>, LanesOf<group>>::type;
  Vector at[groups];

  ARM_INLINE static Row load(const X* numbers) {
    Row row;
    for_each<groups>([&](auto g) __attribute__((always_inline)) {
      row.at[g] = *reinterpret_cast<const Vector*>(numbers + g * group);
    });
    return row;
  }
  ARM_INLINE void store(X* numbers) const {
    for_each<groups>([&](auto g) __attribute__((always_inline)) {
      *reinterpret_cast<Vector*>(numbers + g * group) = at[g];
    });
  }
  // Of numbers that were worked out one by one, and would have to wait for each other in memory.
  ARM_INLINE static Row gather(const X* numbers) {
    if constexpr (kWidth<X> > 1 || N > kUnrollLimit) {
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

// The drives' states z, one row for each (drive.hpp says which), link angle q [rad] and speed v
// [rad/s] (m and m/s for prismatic joints).
template <class S, class X = double>
struct State {
  static constexpr int K = most_states<S>();
  static constexpr int row = kRow<S::N, X>;
  alignas(64) X z[K > 0 ? K : 1][row] = {};
  alignas(64) X q[row] = {}, v[row] = {};
};

// number(x) for everything that a state is, in a fixed order.
template <class S, class X, class Number>
constexpr void for_each_number(State<S, X>& x, Number&& number) {
  for (int j = 0; j < S::N; ++j) {
    for (int k = 0; k < State<S, X>::K; ++k) number(x.z[k][j]);
    number(x.q[j]);
    number(x.v[j]);
  }
}

// What the drive of joint j is asked at, in one lane.
template <class Drive, class S, class X>
ARM_INLINE constexpr auto input_in_lane(const Drive&, int j, const State<S, X>& x, const X& u,
                                        int lane) {
  typename Drive::template Input<double> in = {
      {}, lane_of(x.q[j], lane), lane_of(x.v[j], lane), lane_of(u, lane), {}};
  for (int k = 0; k < Drive::states; ++k) in.z[k] = lane_of(x.z[k][j], lane);
  return in;
}

// What the drive of joint j is asked at.
template <class Drive, class S, class X>
ARM_INLINE constexpr auto input_of(const Drive&, int j, const State<S, X>& x, X u) {
  typename Drive::template Input<X> in = {{}, x.q[j], x.v[j], u, {}};
  for (int k = 0; k < Drive::states; ++k) in.z[k] = x.z[k][j];
  return in;
}

// Take over what the drive of joint j has made of its states, in one lane.
template <class Drive, class S, class X>
constexpr void put_states(const Drive&, int j, int lane,
                          const typename Drive::template Input<double>& from, State<S, X>& x) {
  for (int k = 0; k < Drive::states; ++k) set_lane(x.z[k][j], lane, from.z[k]);
}

}  // namespace arm
