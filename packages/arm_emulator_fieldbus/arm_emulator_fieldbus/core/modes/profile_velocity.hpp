// Profile velocity: a speed, reached with bounded acceleration.
#pragma once

#include "mode.hpp"

namespace fieldbus {

class ProfileVelocity final : public Mode {
 public:
  static constexpr AboutMode about = {
      .number = 3, .name = "profile velocity", .loops = DRIVES_LOOP_SPEED};

  void hold(Axis&) override { reached_ = still_ = {}; }
  void take_over(Axis& axis) override { axis.control_speed(); }
  void run(Axis& axis) override {
    const double target = axis.clamp_speed(axis.values.get<0x60FF>(), axis.profile_speed());
    axis.demand.loop = Loop::speed;
    axis.demand.speed = ramp(axis.demand.speed, target, axis.acceleration<0x6083>(),
                             axis.deceleration<0x6084>(), axis.dt);
  }
  void look(const Axis& axis) override {
    const double speed = axis.measured.speed;
    reached_.look(std::fabs(axis.number<0x60FF>() - speed) <= axis.velocity_window(), axis.dt);
    still_.look(std::fabs(speed) <= axis.velocity_threshold(), axis.dt);
  }
  std::uint16_t compute_status(const Axis& axis, const Situation& now) const override {
    std::uint16_t word = 0;
    const bool reached = axis.has_lasted(reached_.time, axis.values.get<0x606E>());
    if (now.operates && !now.halted && reached) word |= status::target_reached;
    if (axis.has_lasted(still_.time, axis.values.get<0x6070>())) word |= status::bit12;
    return word;
  }

 private:
  Lasting reached_, still_;
};

}  // namespace fieldbus
