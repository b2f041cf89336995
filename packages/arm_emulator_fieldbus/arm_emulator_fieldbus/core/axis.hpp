// One axis for its modes of operation: dictionary, measurements, demands of the inner loops,
// limits.
//
// Internal positions are encoder counts since the start of the machine; those of the dictionary are
// lower by `shift`, which homing sets.
#pragma once

#include <limits>

#include "drives.h"
#include "profile.hpp"
#include "units.hpp"
#include "values.hpp"

namespace fieldbus {

enum class Loop : std::uint8_t { position, speed, torque };

struct Demand {
  Loop loop = Loop::position;
  double position = 0.0;  // counts
  double speed = 0.0;     // counts/s
  double torque = 0.0;    // 0.1 %
  // Whether a target speed, a target position was beyond a limit.
  bool speed_cut = false, position_cut = false;
};

struct Measured {
  std::int64_t counts = 0, turned = 0;  // turned: in the newest period
  std::int64_t index = 0, pulses = 0;   // counts at the newest index pulse, number of pulses
  double speed = 0.0;                   // counts/s
  double torque = 0.0;                  // 0.1 %
  double command = 0.0;                 // V or A that the motor got
  bool powered = true, brake = false, hot = false, diverged = false;
};

struct Axis {
  Axis(const drives_joint& of, const drives_machine& machine)
      : joint(of),
        units(of.servo),
        period(machine.at->period),
        dt(1e-9 * static_cast<double>(machine.at->period)),
        home_to_zero(machine.home_offset == DRIVES_HOME_TO_ZERO),
        values(static_cast<Bus>(machine.bus)) {}

  const drives_joint& joint;
  const Units units;
  const std::int64_t period;  // ns, of the servo
  const double dt;            // s, the same
  const bool home_to_zero;
  Values values;
  std::uint16_t word = 0, word_before = 0;  // controlwords of this period and the one before
  std::int64_t targets = 0;                 // times that the target position was written
  std::int64_t shift = 0;
  std::int64_t cycle = 0;            // ns, of the bus; 0: unknown
  bool interpolation_given = false;  // a master has written 0x60C2
  Demand demand;
  Measured measured;
  int limited = 0;  // bits of enum servo_limits

  template <std::uint16_t index, std::uint8_t sub = 0>
  double number() const {
    return static_cast<double>(values.get<index, sub>());
  }
  double counts() const { return static_cast<double>(measured.counts); }
  // Whether a bit of the controlword was set in this period.
  bool has_risen(std::uint16_t bit) const { return (word & bit) && !(word_before & bit); }

  // ------------------------------------------------------------------------------------ limits

  double most_omega() const {
    const double rpm = number<0x6080>() * kTurn / 60.0;
    return rpm < joint.servo.omega_limit ? rpm : joint.servo.omega_limit;
  }
  double motor_speed() const { return units.speed(most_omega()); }  // counts/s
  double profile_speed() const {
    const double motor = motor_speed(), profile = number<0x607F>();
    return motor < profile ? motor : profile;
  }
  template <std::uint16_t index>
  double acceleration() const {  // counts/s2
    return least_of<index, 0x60C5>() * number<0x2008>();
  }
  template <std::uint16_t index>
  double deceleration() const {  // counts/s2
    return least_of<index, 0x60C6>() * number<0x2008>();
  }
  double velocity_window() const { return number<0x606D>() * number<0x2007>(); }     // counts/s
  double velocity_threshold() const { return number<0x606F>() * number<0x2007>(); }  // counts/s
  double torque_slope() const { return number<0x6087>(); }
  // Software limits in the dictionary's coordinates. A limit at the end of the range has no effect:
  // the position wraps there, and a joint without end would stop after 2^31 counts.
  bool bounded() const { return values.get<0x607D, 1>() < values.get<0x607D, 2>(); }
  std::int64_t least_position() const {
    const std::int64_t low = values.get<0x607D, 1>();
    return bounded() && low > values.get<0x607B, 1>() ? low
                                                      : std::numeric_limits<std::int64_t>::min();
  }
  std::int64_t most_position() const {
    const std::int64_t high = values.get<0x607D, 2>();
    return bounded() && high < values.get<0x607B, 2>() ? high
                                                       : std::numeric_limits<std::int64_t>::max();
  }
  // A position of the dictionary within the software limits, as one inside.
  double clamp_position(std::int64_t position) {
    const std::int64_t low = least_position(), high = most_position();
    const std::int64_t within = position < low ? low : position > high ? high : position;
    demand.position_cut = within != position;
    return static_cast<double>(within + shift);
  }
  double clamp_speed(std::int64_t asked, double most) {
    const double speed = static_cast<double>(asked);
    const double within = speed > most ? most : speed < -most ? -most : speed;
    demand.speed_cut = demand.speed_cut || within != speed;
    return within;
  }

  // ----------------------------------------------------------------------------------- targets

  // The target position 0x607A that is near the motor, in the dictionary's coordinates.
  std::int64_t target_position() const {
    return near(measured.counts - shift, values.get<0x607A>());
  }
  // Periods in the interpolation time 0x60C2, one at least.
  int periods_per_target() const {
    static constexpr double kTen[] = {1.0, 0.1, 0.01, 1e-3, 1e-4, 1e-5, 1e-6};
    const double time = number<0x60C2, 1>() * kTen[-values.get<0x60C2, 2>()];
    const double periods = std::floor(time / dt + 0.5);
    return periods < 1.0 ? 1 : periods > 1e9 ? 1000000000 : static_cast<int>(periods);
  }
  // The position of the home that was found, from now on: CiA 402 adds the home offset to it to get
  // the zero position, and some makers give the home this position.
  void set_home(std::int64_t home) {
    const std::int64_t offset = values.get<0x607C>();
    shift = home_to_zero ? home + offset : home - offset;
  }
  bool has_lasted(double time, std::int64_t ms) const {
    return time + 0.5 * dt >= 1e-3 * static_cast<double>(ms);
  }

  // ----------------------------------------------------------------------- from loop to loop

  // Demands at the motor's present position, without speed.
  void follow_motor() {
    demand.loop = Loop::position;
    demand.position = counts();
    demand.speed = demand.torque = 0.0;
    demand.position_cut = false;
  }
  // Change to a loop without a jump of the motion.
  void control_position() {
    if (demand.loop != Loop::position) demand.position = counts();
    if (demand.loop == Loop::torque) demand.speed = measured.speed;
    demand.loop = Loop::position;
  }
  void control_speed() {
    if (demand.loop == Loop::torque) demand.speed = measured.speed;
    demand.loop = Loop::speed;
  }
  void control_torque() {
    demand.torque = measured.torque;
    demand.loop = Loop::torque;
  }
  void hold_standstill() {
    if (demand.loop != Loop::position) demand.position = counts();
    demand.loop = Loop::position;
    demand.speed = 0.0;
  }

 private:
  template <std::uint16_t index, std::uint16_t largest>
  double least_of() const {
    const double one = number<index>(), most = number<largest>();
    return one < most ? one : most;
  }
};

// Time for which a condition has held without a break.
struct Lasting {
  double time = 0.0;  // s
  void look(bool so, double dt) { time = so ? time + dt : 0.0; }
};

}  // namespace fieldbus
