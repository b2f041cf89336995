// The inner loops of a drive, those of arm_emulator/servo/c/servo.h: from measurements and demands
// to the motor's command.
#pragma once

#include "axis.hpp"
#include "modes/mode.hpp"

namespace fieldbus {

class InnerLoops {
 public:
  explicit InnerLoops(const servo_joint& joint) : servo_(joint) {}
  InnerLoops(const InnerLoops& of) : servo_(of.servo_), state_(of.state_), arm_(of.arm_) {
    arm_.joint = &servo_;
    arm_.state = &state_;
  }
  InnerLoops& operator=(const InnerLoops&) = delete;

  void begin() { servo_joint_reset(&state_); }
  // The command is 0.
  void release() { servo_release(&arm_); }
  double current() const { return state_.current; }  // A

  void observe(const arm_joint_measurement& measured, Axis& axis) {
    Measured& now = axis.measured;
    const std::int64_t before = now.counts;
    servo_observe(&arm_, &measured.encoder, &measured.current, &measured.applied);
    now.counts = servo_.wrap ? state_.counts : measured.encoder;
    now.turned = now.counts - before;
    now.command = measured.applied;
    now.speed = axis.units.speed(state_.omega);
    now.torque = state_.current / axis.units.current;
  }

  // Return the command for the demands, in the unit of the motor's command. `offsets`: of the
  // master; `torque_limit`: of the mode, in 0.1 %.
  double command(Axis& axis, const Offsets& offsets, double torque_limit, bool within_limits) {
    const Units& units = axis.units;
    const Demand& demand = axis.demand;
    servo_wish wish;
    servo_wish_within(&servo_, &wish);
    bound_current(axis, torque_limit, wish);
    wish.most_omega = axis.most_omega();
    wish.least_omega = -wish.most_omega;
    wish.tau = units.tau(offsets.torque);
    switch (demand.loop) {
      case Loop::position:
        wish.wants = SERVO_POSITION;
        wish.q_target = units.q(demand.position);
        wish.v_target = units.v(1e-3 * axis.number<0x2001>() * demand.speed + offsets.speed);
        break;
      case Loop::speed:
        wish.wants = SERVO_SPEED;
        wish.omega = units.omega(demand.speed);
        break;
      case Loop::torque:
        wish.wants = SERVO_CURRENT;
        wish.current = units.current * demand.torque;
        break;
    }
    if (demand.loop != Loop::position && within_limits) bound_speed(axis, wish);
    const double command = servo_drive(&arm_, 0, &wish);
    axis.limited = wish.limited;
    return command;
  }

 private:
  static void bound_current(const Axis& axis, double torque_limit, servo_wish& wish) {
    const double limit = axis.number<0x6072>();
    const auto least_of = [&](double one) {
      const double within = one < limit ? one : limit;
      return axis.units.current * (torque_limit < within ? torque_limit : within);
    };
    const double up = least_of(axis.number<0x60E0>()), down = least_of(axis.number<0x60E1>());
    if (up < wish.most_current) wish.most_current = up;
    if (-down > wish.least_current) wish.least_current = -down;
  }
  // No faster than the motor can stop before a software limit.
  static void bound_speed(const Axis& axis, servo_wish& wish) {
    const double d = axis.deceleration<0x6084>();
    const double at = static_cast<double>(axis.measured.counts - axis.shift);
    const auto limit = [&](double way) {
      return way > 0.0 ? axis.units.omega(std::sqrt(2.0 * d * way)) : 0.0;
    };
    const double up = limit(static_cast<double>(axis.most_position()) - at);
    const double down = -limit(at - static_cast<double>(axis.least_position()));
    if (up < wish.most_omega) wish.most_omega = up;
    if (down > wish.least_omega) wish.least_omega = down;
  }

  servo_joint servo_;
  servo_state state_ = {};
  servo arm_ = {1, 0, &servo_, &state_, {}, 0, 0, 0, 0, 0, 0, 0};
};

}  // namespace fieldbus
