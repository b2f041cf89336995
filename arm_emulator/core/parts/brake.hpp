// A brake on a motor's shaft: friction that comes and goes.
//
// While it is closed, its torque is added to what the rotor's friction has while it slides, and to
// what holds it at rest (rotor_friction.hpp). So a rotor that is caught by it comes to rest within
// a finite time and then stays where it is exactly; what moves behind it is the wind-up of the
// gear. When it closes and opens stands in brakes.hpp.
#pragma once

#include <type_traits>

#include "parts/friction.hpp"

namespace arm {

struct Brake {
  double torque;                      // N m, at the motor's shaft
  double close_delay, release_delay;  // s, from what is wanted to what is
};

template <class Law>
struct Braked : Law {
  Brake brake;
  double closed;  // 1 or 0

  constexpr auto linear() const {
    using Linear = std::remove_cvref_t<decltype(Law::linear())>;
    return Braked<Linear>{Law::linear(), brake, closed};
  }
  constexpr bool is_dry() const { return Law::is_dry() || closed != 0.0; }
  template <class X>
  ARM_INLINE constexpr X sliding(X w, X T) const {
    return Law::sliding(w, T) + closed * brake.torque;
  }
  template <class X>
  ARM_INLINE constexpr X holding(X T) const {
    return Law::holding(T) + closed * brake.torque;
  }
};

}  // namespace arm
