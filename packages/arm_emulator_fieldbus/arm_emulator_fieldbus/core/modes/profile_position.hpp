// Profile position: set points, each reached on a profile of bounded speed and acceleration.
#pragma once

#include "mode.hpp"

namespace fieldbus {

class ProfilePosition final : public Mode {
 public:
  static constexpr AboutMode about = {
      .number = 1, .name = "profile position", .loops = DRIVES_LOOP_POSITION, .follows = true};

  void hold(Axis& axis) override {
    begin(axis);
    profile_.hold_standstill(target_);
    reached_ = {};
  }
  void take_over(Axis& axis) override {
    axis.control_position();
    begin(axis);
    axis.demand.position_cut = false;
    const Demand& now = axis.demand;
    if (now.speed == 0.0) {
      profile_.hold_standstill(now.position);
    } else {  // to where it can stop
      const double d = axis.deceleration<0x6084>();
      plan(axis, now.position + now.speed * std::fabs(now.speed) / (2.0 * d));
    }
  }
  void resume(Axis& axis, bool by_halt) override {
    const double target = target_;
    const bool acknowledged = acknowledged_;
    take_over(axis);
    acknowledged_ = acknowledged;
    if (by_halt) plan(axis, target_ = target);
  }
  void run(Axis& axis) override {
    axis.demand.loop = Loop::position;
    take_set_point(axis);
    profile_.advance(axis.dt, axis.demand.position, axis.demand.speed);
    if (profile_.done() && buffered_) {
      buffered_ = false;
      plan(axis, target_);
    }
  }
  void look(const Axis& axis) override {
    const bool at_target = std::fabs(target_ - axis.counts()) <= axis.number<0x6067>();
    reached_.look(at_target && profile_.done(), axis.dt);
  }
  std::uint16_t compute_status(const Axis& axis, const Situation& now) const override {
    std::uint16_t word = 0;
    const bool reached = axis.has_lasted(reached_.time, axis.values.get<0x6068>());
    if (now.operates && !now.halted && !buffered_ && reached) word |= status::target_reached;
    if (acknowledged_) word |= status::bit12;
    if (now.off) word |= status::bit13;
    return word;
  }

 private:
  void begin(const Axis& axis) {
    target_ = axis.demand.position;
    acknowledged_ = buffered_ = false;
  }
  void plan(const Axis& axis, double target) {
    const double set_speed = axis.number<0x6081>(), limit = axis.profile_speed();
    const double speed = set_speed < limit ? set_speed : limit;
    profile_.plan(axis.demand.position, axis.demand.speed, target,
                  {speed, axis.acceleration<0x6083>(), axis.deceleration<0x6084>()});
    reached_ = {};
  }
  void take_set_point(Axis& axis) {
    if (!(axis.word & control::new_set_point)) {
      acknowledged_ = buffered_;
      return;
    }
    const bool at_once = axis.word & control::change_at_once;
    if (!axis.has_risen(control::new_set_point) || (acknowledged_ && !at_once)) return;
    if (buffered_) target_ = profile_.target();  // the set-point that waits is discarded
    const std::int64_t from = static_cast<std::int64_t>(std::floor(target_ + 0.5)) - axis.shift;
    const bool relative = axis.word & control::relative;
    target_ =
        axis.clamp_position(relative ? from + axis.values.get<0x607A>() : axis.target_position());
    acknowledged_ = true;
    buffered_ = !at_once && !profile_.done();
    if (!buffered_) plan(axis, target_);
  }

  Trapezoid profile_;
  double target_ = 0.0;
  bool acknowledged_ = false;  // the newest set point was taken
  bool buffered_ = false;      // it waits until the one before is reached
  Lasting reached_;
};

}  // namespace fieldbus
