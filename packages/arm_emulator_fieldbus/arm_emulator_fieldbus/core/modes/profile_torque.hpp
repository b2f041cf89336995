// Profile torque: a torque, reached on a slope.
#pragma once

#include "mode.hpp"

namespace fieldbus {

class ProfileTorque final : public Mode {
 public:
  static constexpr AboutMode about = {.number = 4,
                                      .name = "profile torque",
                                      .loops = DRIVES_LOOP_TORQUE | DRIVES_LOOP_SPEED_LIMIT,
                                      .halts_in_torque = true};

  void take_over(Axis& axis) override { axis.control_torque(); }
  void resume(Axis& axis, bool /*by_halt*/) override {
    if (axis.demand.loop != Loop::torque) axis.control_torque();
  }
  void run(Axis& axis) override {
    const double slope = axis.torque_slope();
    axis.demand.loop = Loop::torque;
    axis.demand.torque = ramp(axis.demand.torque, axis.number<0x6071>(), slope, slope, axis.dt);
  }
  std::uint16_t compute_status(const Axis& axis, const Situation& now) const override {
    const bool reached = axis.demand.torque == axis.number<0x6071>();
    return now.operates && !now.halted && reached ? status::target_reached : 0;
  }
};

}  // namespace fieldbus
