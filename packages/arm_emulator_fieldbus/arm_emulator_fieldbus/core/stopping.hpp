// Stop of a motor: by a ramp, with the largest torque, or, in a mode that controls torque, with
// zero torque.
#pragma once

#include "axis.hpp"
#include "cia402.hpp"

namespace fieldbus {

class Stopping {
 public:
  bool halted() const { return halted_; }    // it slows down, or stands after that
  bool by_halt() const { return by_halt_; }  // the newest one was a halt
  bool stands() const { return stands_; }

  void end() { *this = {}; }
  void begin(bool by_halt) {
    halted_ = true;
    by_halt_ = by_halt;
  }

  // A period of it. The torque decreases to 0; the motor coasts.
  void reduce_torque(Axis& axis) {
    const double slope = axis.torque_slope();
    axis.demand.torque = ramp(axis.demand.torque, 0.0, slope, slope, axis.dt);
    stands_ = axis.demand.torque == 0.0 && is_slow(axis);
  }
  void slow_down(Axis& axis, Stop way) {
    Demand& demand = axis.demand;
    if (way == Stop::torque_limit && !stands_) {
      axis.control_speed();
      demand.speed = 0.0;
    } else {
      if (demand.loop == Loop::torque) axis.control_speed();
      const double d =
          way == Stop::quick_ramp ? axis.deceleration<0x6085>() : axis.deceleration<0x6084>();
      const double before = demand.speed;
      demand.speed = ramp(demand.speed, 0.0, d, d, axis.dt);
      if (demand.loop == Loop::position) demand.position += 0.5 * (before + demand.speed) * axis.dt;
    }
    finish_stopping(axis);
  }

 private:
  static constexpr double kLongest = 0.5;  // s that a motor may creep at the end

  static bool is_slow(const Axis& axis) {
    return std::fabs(axis.measured.speed) <= axis.velocity_threshold();
  }
  void finish_stopping(Axis& axis) {
    const bool at_end = axis.demand.speed == 0.0;
    stuck_.look(at_end, axis.dt);
    stands_ = at_end && (is_slow(axis) || stuck_.time > kLongest);
    if (!stands_ || axis.demand.loop != Loop::speed) return;
    axis.demand.position = axis.counts();
    axis.demand.loop = Loop::position;
  }

  bool halted_ = false, by_halt_ = false, stands_ = false;
  Lasting stuck_;
};

}  // namespace fieldbus
