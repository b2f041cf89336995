// State of the machine at one instant.
#pragma once

#include "mechanics/scene.hpp"
#include "numerics/row.hpp"

namespace arm {

// The drives' states z, one row for each (listed in drive.hpp). Link angle q [rad] and speed v
// [rad/s] (m and m/s for prismatic joints).
template <class S, class X = Real>
struct State {
  static constexpr int K = max_states<S>();
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

// Inputs of the drive of joint j, in one lane.
template <class Drive, class S, class X>
ARM_INLINE constexpr auto input_in_lane(const Drive&, int j, const State<S, X>& x, const X& u,
                                        int lane) {
  typename Drive::template Input<Real> in = {
      {}, lane_of(x.q[j], lane), lane_of(x.v[j], lane), lane_of(u, lane), {}};
  for (int k = 0; k < Drive::states; ++k) in.z[k] = lane_of(x.z[k][j], lane);
  return in;
}

// Inputs of the drive of joint j.
template <class Drive, class S, class X>
ARM_INLINE constexpr auto input_of(const Drive&, int j, const State<S, X>& x,
                                   std::type_identity_t<X> u) {
  typename Drive::template Input<X> in = {{}, x.q[j], x.v[j], u, {}};
  for (int k = 0; k < Drive::states; ++k) in.z[k] = x.z[k][j];
  return in;
}

// Take over what the drive of joint j has made of its states, in one lane.
template <class Drive, class S, class X>
constexpr void store_states(const Drive&, int j, int lane,
                            const typename Drive::template Input<Real>& from, State<S, X>& x) {
  for (int k = 0; k < Drive::states; ++k) set_lane(x.z[k][j], lane, from.z[k]);
}

}  // namespace arm
