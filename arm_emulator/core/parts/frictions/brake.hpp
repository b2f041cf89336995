// A brake on a motor's shaft: friction that is switched.
//
// While it is closed, its torque adds to the sliding and to the breakaway torque of the rotor
// (rotor_friction.hpp). The rotor stops within a finite time and then rests exactly; the link still
// moves by the gear's wind-up. brakes.hpp has the times at which it closes and opens.
#pragma once

#include <type_traits>

#include "parts/frictions/friction.hpp"

namespace arm {

struct Brake {
  constexpr bool operator==(const Brake&) const = default;

  Real torque;                      // N m, at the motor's shaft
  Real close_delay, release_delay;  // s, from the request to the change
};

template <class Law>
struct Braked : Law {
  // g++ 11 leaves the base out of a defaulted comparison.
  constexpr bool operator==(const Braked& other) const {
    return Law::operator==(other) && brake == other.brake && closed == other.closed;
  }

  Brake brake;
  Real closed;  // 1 or 0

  constexpr auto linear() const {
    using Linear = std::remove_cvref_t<decltype(Law::linear())>;
    return Braked<Linear>{Law::linear(), brake, closed};
  }
  constexpr bool is_dry() const { return Law::is_dry() || closed != 0.0; }
  template <class X>
  ARM_INLINE constexpr X sliding_torque(X w, const ShaftTorques<X>& on) const {
    return Law::sliding_torque(w, on) + closed * brake.torque;
  }
  template <class X>
  ARM_INLINE constexpr X holding_torque(const ShaftTorques<X>& on) const {
    return Law::holding_torque(on) + closed * brake.torque;
  }
};

}  // namespace arm
