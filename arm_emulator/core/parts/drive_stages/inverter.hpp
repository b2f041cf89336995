// The voltage that an inverter loses to dead time, transistors and diodes: U along the current i,
//
//   v = u - U i / sqrt(|i|^2 + knee^2)
//
// of a motor in the frame of its rotor with the vectors (d, q) of voltage and current. The loss
// heats the inverter, not the winding. The schemes' matrix has its slope at i = 0, U / knee, which
// is the largest.
#pragma once

#include "numerics/number.hpp"
#include "parts/command.hpp"

namespace arm {

struct Inverter {
  constexpr bool operator==(const Inverter&) const = default;

  Real U;     // V
  Real knee;  // A
};

template <class Motor>
struct InvertedMotor : Motor {
  // g++ 11 leaves the base out of a defaulted comparison.
  constexpr bool operator==(const InvertedMotor& other) const {
    return Motor::operator==(other) && inverter == other.inverter;
  }

  Inverter inverter;

  constexpr auto linear() const {
    auto motor = Motor::linear();
    motor.R += inverter.U / inverter.knee;
    return motor;
  }

  template <class X>
  ARM_INLINE constexpr void rates(const X* z, X u, X tm, X wm, X offset, bool active, X* f) const {
    Motor::rates(z, u, tm, wm, offset, active, f);
    if constexpr (of_vectors)
      f[0] -= slope(z) * z[0], f[1] -= slope(z) * z[1];
    else if (this->obeys_circuit(active))
      f[0] -= slope(z) * z[0];
  }

  template <class X>
  ARM_INLINE constexpr X dissipated_power(const X* z) const {
    return Motor::dissipated_power(z) + lost_voltage(z);
  }
  // A current that is held at its limit takes what is lost from the supply, too.
  template <class X>
  ARM_INLINE constexpr X supplied_power(const X* z, X u, X tm, X wm, bool active) const {
    X power = Motor::supplied_power(z, u, tm, wm, active);
    if constexpr (!of_vectors)
      if (!this->obeys_circuit(active)) power += lost_voltage(z);
    return power;
  }

  constexpr auto mode_at(const Real* z, Real u, Real wm) const {
    return Motor::mode_at(z, remaining_voltage(z, u), wm);
  }
  constexpr auto required_mode(const Real* z, Real u, Real wm, const auto& mode) const {
    return Motor::required_mode(z, remaining_voltage(z, u), wm, mode);
  }
  constexpr Real margin(const Real* z, Real u, Real wm, const auto& mode) const {
    return Motor::margin(z, remaining_voltage(z, u), wm, mode);
  }

 private:
  static constexpr bool of_vectors = requires(Motor motor) { motor.psi; };
  template <class X>
  ARM_INLINE constexpr X slope(const X* z) const {
    X square = z[0] * z[0] + inverter.knee * inverter.knee;
    if constexpr (of_vectors) square += z[1] * z[1];
    return inverter.U / square_root(square);
  }
  template <class X>
  ARM_INLINE constexpr X lost_voltage(const X* z) const {
    if constexpr (of_vectors) return 1.5 * slope(z) * (z[0] * z[0] + z[1] * z[1]);
    return slope(z) * z[0] * z[0];
  }
  // The rest of a command that is a voltage.
  constexpr Real remaining_voltage(const Real* z, Real u) const {
    return Motor::takes == Command::voltage ? u - slope(z) * z[0] : u;
  }
};

}  // namespace arm
