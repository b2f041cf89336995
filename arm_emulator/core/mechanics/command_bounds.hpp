// Commands within the bounds of the motors that they go to.
#pragma once

#include "mechanics/numbers.hpp"
#include "mechanics/state.hpp"

namespace arm {

// Put the commands u of all joints within their bounds at the state x.
template <class S, class X>
ARM_INLINE void bound_commands(const Numbers<S, X>& n, const State<S, X>& x, X* u) {
  if constexpr (!any_drive<S>([](const auto& drive) { return !drive.bounded_by_supply; })) {
    for_each<S::N>([&](auto j) __attribute__((always_inline)) { u[j] = clamp(u[j], n.supply()); });
  } else if constexpr (kWidth<X> == 1 || !Numbers<S, X>::drives_vary) {
    n.for_each_drive([&](const auto& drive, int j) __attribute__((always_inline)) {
      u[j] = drive.bound_command(input_of(drive, j, x, u[j]), n.supply());
    });
  } else {
    for (int lane = 0; lane < kWidth<X>; ++lane)
      n.for_each_drive_of(lane, [&](const auto& drive, int j) {
        set_lane(u[j], lane,
                 drive.bound_command(input_in_lane(drive, j, x, u[j], lane), n.supply_of(lane)));
      });
  }
}

}  // namespace arm
