// Where all drives are in their usual modes, surely (mode.hpp).
#pragma once

#include "mechanics/numbers.hpp"
#include "mechanics/state.hpp"

namespace arm {

// Whether x, as the start and as the end of a step, calls for them.
template <class S, class X>
ARM_INLINE Mask<X> is_usual(const Numbers<S, X>& n, const State<S, X>& x, const X* u) {
  Mask<X> usual = X{} == X{};
  if constexpr (kWidth<X> == 1 || !Numbers<S, X>::drives_vary) {
    n.for_each_drive([&](const auto& drive, int j) __attribute__((always_inline)) {
      usual &= drive.is_usual(input_of(drive, j, x, u[j]));
    });
  } else {
    for (int lane = 0; lane < kWidth<X>; ++lane)
      n.for_each_drive_of(lane, [&](const auto& drive, int j) __attribute__((always_inline)) {
        if (!drive.is_usual(input_in_lane(drive, j, x, u[j], lane))) usual[lane] = 0;
      });
  }
  return usual;
}

// Whether there is such an x, where the brakes are open.
template <class S>
constexpr bool is_ever_usual() {
  return std::apply([](const auto&... drive) { return (true && ... && drive.is_ever_usual()); },
                    Constants<S>::sheet.drives);
}

}  // namespace arm
