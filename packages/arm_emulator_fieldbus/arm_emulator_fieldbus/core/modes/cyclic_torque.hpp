// Cyclic synchronous torque: the master sends torques.
#pragma once

#include "mode.hpp"

namespace fieldbus {

class CyclicTorque final : public Mode {
 public:
  static constexpr AboutMode about = {
      .number = 10, .name = "cyclic torque", .loops = DRIVES_LOOP_TORQUE | DRIVES_LOOP_SPEED_LIMIT};

  void take_over(Axis& axis) override { axis.control_torque(); }
  void resume(Axis& axis, bool /*by_halt*/) override {
    if (axis.demand.loop != Loop::torque) axis.control_torque();
  }
  void run(Axis& axis) override {
    axis.demand.loop = Loop::torque;
    axis.demand.torque = static_cast<double>(axis.values.get<0x6071>() + axis.values.get<0x60B2>());
  }
  std::uint16_t compute_status(const Axis&, const Situation& now) const override {
    return now.follows();
  }
};

}  // namespace fieldbus
