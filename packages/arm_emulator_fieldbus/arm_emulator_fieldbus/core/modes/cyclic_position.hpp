// Cyclic synchronous position: the master sends positions, a line joins them.
#pragma once

#include "../interpolation.hpp"
#include "mode.hpp"

namespace fieldbus {

class CyclicPosition final : public Mode {
 public:
  static constexpr AboutMode about = {
      .number = 8, .name = "cyclic position", .loops = DRIVES_LOOP_POSITION, .follows = true};

  void hold(Axis& axis) override { begin(axis); }
  void take_over(Axis& axis) override {
    axis.control_position();
    axis.demand.position_cut = false;
    begin(axis);
  }
  void run(Axis& axis) override {
    if (taken_ != axis.targets)
      line_.aim(axis.clamp_position(axis.target_position() + axis.values.get<0x60B0>()),
                axis.periods_per_target());
    taken_ = axis.targets;
    line_.advance(axis.dt, 1e-4 * axis.number<0x2002>());
    axis.demand.loop = Loop::position;
    axis.demand.position = line_.position();
    axis.demand.speed = line_.speed();
  }
  Offsets compute_offsets(const Axis& axis) const override {
    return {axis.number<0x60B1>(), axis.number<0x60B2>()};
  }
  std::uint16_t compute_status(const Axis&, const Situation& now) const override {
    return now.follows() | (now.off ? status::bit13 : 0);
  }

 private:
  void begin(const Axis& axis) {
    line_.begin(axis.demand.position);
    taken_ = 0;
  }

  Interpolation line_;
  std::int64_t taken_ = 0;  // of the targets that were written
};

}  // namespace fieldbus
