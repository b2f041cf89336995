// A torque on the link as a table over its angle: a measured counterbalance, the drag of hoses. A
// cubic joins two points of the table,
//
//   T = T0 + T1 s + T2 s^2 + T3 s^3      s = q - q0
//
// with coefficients (parts/joint_effects/torque_table.py) that make torque and slope continuous.
// Beyond its ends the table keeps their torque, or repeats with its period. It dissipates nothing;
// its potential, the integral of -T, is 0 at the first point and may become negative, like
// gravity's.
#pragma once

#include <array>

#include "parts/joint_effects/no_torque.hpp"

namespace arm {

template <int n, bool periodic>
struct TorqueTable : NoTorque<Place::link> {
  struct Piece {
    constexpr bool operator==(const Piece&) const = default;

    Real q0;              // rad (m), where it begins
    Real T0, T1, T2, T3;  // N m/rad^0, 1, 2, 3
    Real U0;              // J, potential at q0
  };
  std::array<Piece, n> pieces;
  Real end;    // rad (m), where the last of them ends
  Real U_end;  // J

  constexpr bool operator==(const TorqueTable&) const = default;

  template <class X>
  ARM_INLINE constexpr X torque(X q, X, const X*, X, bool) const {
    return evaluate(q).torque;
  }
  template <class X>
  ARM_INLINE constexpr X potential_energy_at(X q) const {
    return evaluate(q).potential;
  }

 private:
  template <class X>
  struct Value {
    X torque, potential;
  };

  template <class X>
  ARM_INLINE constexpr Value<X> evaluate(const X& q) const {
    const Real begin = pieces[0].q0, period = end - begin;
    X periods{};
    if constexpr (periodic)
      for (int lane = 0; lane < kWidth<X>; ++lane)
        set_lane(periods, lane, __builtin_floor(value_of((lane_of(q, lane) - begin) / period)));
    const X angle = q - periods * period;
    const X within = select(angle < begin, X{} + begin, select(angle > end, X{} + end, angle));
    X q0{}, T0{}, T1{}, T2{}, T3{}, U0{};
    for (int lane = 0; lane < kWidth<X>; ++lane) {
      const Piece& piece = pieces[find_piece(lane_of(within, lane))];
      set_lane(q0, lane, piece.q0), set_lane(U0, lane, piece.U0);
      set_lane(T0, lane, piece.T0), set_lane(T1, lane, piece.T1);
      set_lane(T2, lane, piece.T2), set_lane(T3, lane, piece.T3);
    }
    const X s = within - q0;
    const X torque = T0 + s * (T1 + s * (T2 + s * T3));
    const X work = s * (T0 + s * (T1 / 2.0 + s * (T2 / 3.0 + s * (T3 / 4.0))));
    const X beyond = periodic ? periods * U_end : (within - angle) * torque;
    return {torque, U0 - work + beyond};
  }
  // The last piece that begins at or before an angle, by bisection.
  ARM_INLINE constexpr int find_piece(Real angle) const {
    int first = 0;
    for (int count = n; count > 1;) {
      const int half = count / 2;
      first = pieces[first + half].q0 <= angle ? first + half : first;
      count -= half;
    }
    return first;
  }
};

}  // namespace arm
