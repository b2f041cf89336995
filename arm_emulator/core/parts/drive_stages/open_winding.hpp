// A motor whose drive regulates its currents, or its torque, and whose winding may be open. What
// the drive drives through the winding falls as through a resistance that grows by the factor
// 1 + 1e6 s, as the current of a motor at a voltage does (dc_motor.hpp):
//
//   1 / (2 pi f) dz/dt = u - (1 + 1e6 s) z          s: 0 sound, 1 open
#pragma once

#include "numerics/number.hpp"

namespace arm {

template <class Motor>
struct OpenedMotor : Motor {
  // g++ 11 leaves the base out of a defaulted comparison.
  constexpr bool operator==(const OpenedMotor& other) const {
    return Motor::operator==(other) && open == other.open;
  }

  Real open;  // s

  constexpr auto linear() const {
    const auto motor = Motor::linear();
    return OpenedMotor<std::remove_const_t<decltype(motor)>>{motor, open};
  }

  template <class X>
  ARM_INLINE constexpr void rates(const X* z, X u, X tm, X wm, X offset, bool active, X* f) const {
    Motor::rates(z, u, tm, wm, offset, active, f);
    for (int k = 0; k < Motor::regulated; ++k) f[k] -= kOpen * open * z[k];
  }
  constexpr void set_algebraic_state(Real* z, Real u, Real wm) const {
    Motor::set_algebraic_state(z, u / (1.0 + kOpen * open), wm);
  }

 private:
  static constexpr Real kOpen = 1e6;
};

}  // namespace arm
