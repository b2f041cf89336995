// The temperature of a motor's winding, as one body: its rise Theta over the ambient [K] is a
// state,
//
//   C dTheta/dt = P - Theta / Rth          P = copper loss at the temperature now, without that
//                                          of contacts
//   R = R0 (1 + alpha (T - Tref))          T = ambient + Theta
//   Kt, Kb (psi) = those at Tref times (1 + beta (T - Tref)), at least 0
//
// One temperature stands for copper and magnets. Products with currents are nonlinear: the schemes'
// matrix has resistance and constants at fixed temperatures (`linear`), the rest enters each stage.
#pragma once

#include "numerics/number.hpp"

namespace arm {

struct Winding {
  constexpr bool operator==(const Winding&) const = default;

  Real C;              // J/K
  Real Rth;            // K/W, to the ambient
  Real ambient;        // degC
  Real reference;      // degC, of the motor's numbers
  Real alpha;          // 1/K
  Real beta;           // 1/K, not above 0
  Real limit = 1e300;  // degC, beyond which the drive switches off
};

// `whole` false: at fixed temperatures and without the loss, which is linear.
template <class Motor, bool whole = true>
struct HeatedMotor : Motor {
  // g++ 11 leaves the base out of a defaulted comparison.
  constexpr bool operator==(const HeatedMotor& other) const {
    return Motor::operator==(other) && winding == other.winding;
  }

  Winding winding;

  static constexpr int rise = Motor::states, states = rise + 1;  // Theta [K]

  // Steps of any length stay stable as long as the resistance is less than 1.17 times that of the
  // matrix. It may be far below. (This is the stability of a W-method with fast currents.)
  static constexpr double kOfMatrix = 150.0;  // degC
  constexpr auto linear() const {
    if constexpr (whole) {
      auto motor = Motor::linear();
      motor.R *= 1.0 + winding.alpha * (kOfMatrix - winding.reference);
      return HeatedMotor<decltype(motor), false>{motor, winding};
    } else {
      return *this;
    }
  }

  constexpr Real inertia(int k, bool active) const {
    return k == rise ? winding.C : Motor::inertia(k, active);
  }
  template <class X>
  ARM_INLINE constexpr void rates(const X* z, X u, X tm, X wm, X offset, bool active, X* f) const {
    Motor::rates(z, u, tm, wm, offset, active, f);
    f[rise] = -z[rise] / winding.Rth;
    if constexpr (whole) {
      const X R = (resistance(z) - 1.0) * this->R, flux = magnets(z) - 1.0;
      if constexpr (requires { this->psi; }) {
        f[0] -= R * z[0];
        f[1] -= R * z[1] + flux * this->p * this->psi * wm;
      } else if (this->obeys_circuit(active)) {
        f[0] -= R * z[0] + flux * this->Kb * wm;
      }
      f[rise] += resistance(z) * Motor::copper_loss(z);
    }
  }
  template <class X>
  ARM_INLINE constexpr X torque(const X* z, X tm) const {
    X T = Motor::torque(z, tm);
    if constexpr (whole) {
      if constexpr (requires { this->psi; })
        T += (magnets(z) - 1.0) * (1.5 * this->p * this->psi) * z[1];
      else
        T += (magnets(z) - 1.0) * this->Kt * z[0];
    }
    return T;
  }
  template <class X>
  ARM_INLINE constexpr X dissipated_power(const X* z) const {
    const X copper = Motor::copper_loss(z);
    return resistance(z) * copper + (Motor::dissipated_power(z) - copper);
  }
  template <class X>
  ARM_INLINE constexpr X supply_limit(const X* z, X u, X wm) const {
    return Motor::supply_limit(z, u, magnets(z) * wm) / resistance(z);
  }

  // `motor` with its numbers at this temperature.
  constexpr Real supplied_power(const Real* z, Real u, Real tm, Real wm, bool active) const {
    return motor_at_temperature(z).supplied_power(z, u, tm, wm, active);
  }
  constexpr void set_algebraic_state(Real* z, Real u, Real wm) const {
    motor_at_temperature(z).set_algebraic_state(z, u, wm);
  }
  constexpr auto mode_at(const Real* z, Real u, Real wm) const {
    return motor_at_temperature(z).mode_at(z, u, wm);
  }
  constexpr auto required_mode(const Real* z, Real u, Real wm, const auto& mode) const {
    return motor_at_temperature(z).required_mode(z, u, wm, mode);
  }
  constexpr Real margin(const Real* z, Real u, Real wm, const auto& mode) const {
    return motor_at_temperature(z).margin(z, u, wm, mode);
  }

  constexpr Real temperature(const Real* z) const { return winding.ambient + z[rise]; }
  constexpr bool is_overheated(const Real* z) const { return temperature(z) > winding.limit; }

 private:
  // Factors of resistance and constants, relative to the reference.
  template <class X>
  ARM_INLINE constexpr X resistance(const X* z) const {
    return 1.0 + winding.alpha * (winding.ambient - winding.reference + z[rise]);
  }
  template <class X>
  ARM_INLINE constexpr X magnets(const X* z) const {
    const X left = 1.0 + winding.beta * (winding.ambient - winding.reference + z[rise]);
    return select(left > 0.0, left, X{});
  }
  constexpr Motor motor_at_temperature(const Real* z) const {
    Motor motor = *this;
    motor.R *= resistance(z);
    if constexpr (requires { motor.psi; })
      motor.psi *= magnets(z);
    else
      motor.Kt *= magnets(z), motor.Kb *= magnets(z);
    return motor;
  }
};

}  // namespace arm
