// Where all drives are in their regular modes, surely (mode.hpp).
#pragma once

#include "mechanics/numbers.hpp"
#include "mechanics/state.hpp"

namespace arm {

// Whether x, as the start and as the end of a step, calls for them.
template <class S, class X>
ARM_INLINE Mask<X> is_regular(const Numbers<S, X>& n, const State<S, X>& x, const X* u) {
  Mask<X> regular = X{} == X{};
  if constexpr (kWidth<X> == 1 || !Numbers<S, X>::drives_vary) {
    n.for_each_drive([&](const auto& drive, int j) __attribute__((always_inline)) {
      regular &= drive.is_regular(input_of(drive, j, x, u[j]));
    });
  } else {
    for (int lane = 0; lane < kWidth<X>; ++lane)
      n.for_each_drive_of(lane, [&](const auto& drive, int j) __attribute__((always_inline)) {
        if (!drive.is_regular(input_in_lane(drive, j, x, u[j], lane))) regular[lane] = 0;
      });
  }
  return regular;
}

// Whether there is such an x, where the brakes are open.
template <class S>
constexpr bool is_ever_regular() {
  return std::apply([](const auto&... drive) { return (true && ... && drive.is_ever_regular()); },
                    Constants<S>::derived.drives);
}

}  // namespace arm
