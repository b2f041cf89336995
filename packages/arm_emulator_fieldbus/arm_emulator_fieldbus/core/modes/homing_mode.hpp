// Homing: the drive searches its home by a method of homing.hpp, and counts from there.
#pragma once

#include "../homing.hpp"
#include "mode.hpp"

namespace fieldbus {

class HomingMode final : public Mode {
 public:
  static constexpr AboutMode about = {.number = 6,
                                      .name = "homing",
                                      .loops = DRIVES_LOOP_POSITION | DRIVES_LOOP_SPEED,
                                      .within_limits = false};

  void hold(Axis&) override { homing_.interrupt(); }
  void take_over(Axis& axis) override { axis.control_speed(); }
  void resume(Axis&, bool /*by_halt*/) override {}
  void run(Axis& axis) override {
    const Measured& now = axis.measured;
    if (!(axis.word & control::start_homing))
      homing_.interrupt();
    else if (axis.has_risen(control::start_homing) && !homing_.moves())
      homing_.start(static_cast<int>(axis.values.get<0x6098>()), now.counts, now.pulses);
    move(axis);
    const bool pressing = (axis.limited & SERVO_LIMITS_CURRENT) &&
                          std::fabs(now.speed) <= 0.1 * axis.number<0x6099, 1>();
    homing_.look(now.counts, now.pulses, now.index, pressing, axis.demand.speed,
                 axis.joint.counts_per_turn, axis.dt);
    std::int64_t place = 0;
    if (!homing_.take(place)) return;
    axis.set_home(place);
    axis.hold_standstill();
  }
  double find_torque_limit(const Axis& axis) const override {
    const bool presses = homing_.moves() && Homing::is_by_stop(axis.values.get<0x6098>());
    return presses ? axis.number<0x2003>() : Mode::find_torque_limit(axis);
  }
  std::uint16_t compute_status(const Axis& axis, const Situation& now) const override {
    std::uint16_t word = 0;
    if (homing_.phase() == Homing::Phase::attained) word |= status::bit12;
    if (homing_.phase() == Homing::Phase::failed) word |= status::bit13;
    const bool interrupted = now.halted || now.stops || !now.operates;
    if (!interrupted && !homing_.moves() && axis.demand.speed == 0.0)
      word |= status::target_reached;
    return word;
  }

 private:
  void move(Axis& axis) const {
    if (!homing_.moves() && axis.demand.speed == 0.0) return axis.hold_standstill();
    const bool search = homing_.phase() == Homing::Phase::to_stop;
    const double requested = search ? axis.number<0x6099, 1>() : axis.number<0x6099, 2>();
    const double limit = axis.profile_speed(), a = axis.acceleration<0x609A>();
    const double speed = homing_.direction() * (requested < limit ? requested : limit);
    axis.control_speed();
    axis.demand.speed = ramp(axis.demand.speed, speed, a, a, axis.dt);
  }

  Homing homing_;
};

}  // namespace fieldbus
