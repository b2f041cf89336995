// Motors and gears, joint by joint: eq. (1) and (2).
//
// Backward Euler makes (1) and (2) a linear system in the next current, motor angle and speed.
// With i' = (L i + h (V - Kb wm')) / (L + h R) and tm' = tm + h wm' put into (2), what remains is
// one scalar equation in wm', whose coefficients depend on the step h only and are computed once.
// L = 0 needs no case of its own: then i' = (V - Kb wm') / R.
#pragma once

#include "scene.hpp"

namespace arm {

// Backward Euler coefficients of one motor for one step h.
struct MotorStep {
  double from_current, from_voltage,
      from_speed;                  // i' = from_current i + from_voltage V - from_speed wm'
  double inverse_inertia;          // 1 / (Mm + h Kt from_speed + h Ng^2 (h Kg + Dg))
  double inverse_inertia_limited;  // the same with the current at its limit
};

ARM_INLINE constexpr MotorStep motor_step(const Motor& motor, const Gear& gear, double h) {
  const double Z = motor.L + h * motor.R;
  const double from_speed = h * motor.Kb / Z;
  const double inertia = motor.Mm + h * gear.Ng * gear.Ng * (h * gear.Kg + gear.Dg);
  return {motor.L / Z, h / Z, from_speed, 1.0 / (inertia + h * motor.Kt * from_speed),
          1.0 / inertia};
}

// Torque T on the link, eq. (2).
ARM_INLINE constexpr double gear_torque(const Gear& gear, double tm, double wm, double q,
                                        double v) {
  return gear.Kg * (gear.Ng * tm - q) + gear.Dg * (gear.Ng * wm - v);
}

ARM_INLINE constexpr double clamp(double x, double limit) {
  return x > limit ? limit : x < -limit ? -limit : x;
}

// Torque on the link of joint j: the gear's, or with a rigid gear the motor's.
template <class State>
ARM_INLINE double drive_torque(const Joint& joint, const State& x, int j) {
  if (!joint.motor.present) return 0.0;
  if (joint.gear.rigid) return joint.motor.Kt / joint.gear.Ng * x.i[j];
  return gear_torque(joint.gear, x.tm[j], x.wm[j], x.q[j], x.v[j]);
}

// Inertia of a rotor that turns with its link, as the link feels it.
ARM_INLINE constexpr double carried_rotor(const Joint& joint) {
  const bool carried = joint.motor.present && joint.gear.rigid;
  return carried ? joint.motor.Mm / (joint.gear.Ng * joint.gear.Ng) : 0.0;
}

// One backward Euler step of an elastic joint's motor, the link held at (q, v). Sets i, tm, wm.
ARM_INLINE void step_motor(const Motor& motor, const Gear& gear, const MotorStep& c, double h,
                           double V, double q, double v, double& i, double& tm, double& wm) {
  const double from_link =
      motor.Mm * wm - h * gear.Ng * (gear.Kg * (gear.Ng * tm - q) - gear.Dg * v);
  const double i_0 = c.from_current * i + c.from_voltage * V;
  double wm_next = (from_link + h * motor.Kt * i_0) * c.inverse_inertia;
  double i_next = i_0 - c.from_speed * wm_next;
  if (motor.current_limit > 0.0 &&
      (i_next > motor.current_limit || i_next < -motor.current_limit)) {
    i_next = clamp(i_next, motor.current_limit);
    wm_next = (from_link + h * motor.Kt * i_next) * c.inverse_inertia_limited;
  }
  i = i_next;
  wm = wm_next;
  tm += h * wm_next;
}

// The current alone, for a motor that turns with its link (rigid gear) at speed wm.
ARM_INLINE double step_current(const Motor& motor, const MotorStep& c, double V, double i,
                               double wm) {
  const double i_next = c.from_current * i + c.from_voltage * V - c.from_speed * wm;
  return motor.current_limit > 0.0 ? clamp(i_next, motor.current_limit) : i_next;
}

}  // namespace arm
