// Cyclic synchronous velocity: the master sends speeds.
#pragma once

#include "mode.hpp"

namespace fieldbus {

class CyclicVelocity final : public Mode {
 public:
  static constexpr AboutMode about = {
      .number = 9, .name = "cyclic velocity", .loops = DRIVES_LOOP_SPEED};

  void take_over(Axis& axis) override { axis.control_speed(); }
  void run(Axis& axis) override {
    const std::int64_t asked = axis.values.get<0x60FF>() + axis.values.get<0x60B1>();
    axis.demand.loop = Loop::speed;
    axis.demand.speed = axis.clamp_speed(asked, axis.motor_speed());
  }
  Offsets compute_offsets(const Axis& axis) const override { return {0.0, axis.number<0x60B2>()}; }
  std::uint16_t compute_status(const Axis&, const Situation& now) const override {
    return now.follows();
  }
};

}  // namespace fieldbus
