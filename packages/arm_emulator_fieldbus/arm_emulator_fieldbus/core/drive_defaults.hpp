// Initial values of a drive's dictionary that depend on its joint, beyond the standard values of
// the table.
#pragma once

#include "axis.hpp"
#include "homing.hpp"

namespace fieldbus {

// The time in the largest unit in which it is a whole number, from ms down; else as near as it
// gets.
inline void set_interpolation_time(Values& of, std::int64_t period) {
  constexpr std::int64_t unit[] = {1000000, 100000, 10000, 1000, 10000000, 100000000, 1000000000};
  constexpr int exponent[] = {-3, -4, -5, -6, -2, -1, 0};
  std::int64_t nearest = -1, value = 1;
  int power = -6;
  for (std::size_t k = 0; k < std::size(unit); ++k) {
    const std::int64_t multiple = (period + unit[k] / 2) / unit[k];
    const std::int64_t off = std::abs(period - multiple * unit[k]);
    if (multiple < 1 || multiple > 255 || (nearest >= 0 && off >= nearest)) continue;
    nearest = off;
    value = multiple;
    power = exponent[k];
  }
  of.set<0x60C2, 1>(value);
  of.set<0x60C2, 2>(power);
}

// The smallest power of ten in whose unit a value is not above the largest.
inline std::int64_t choose_unit(double value, double largest) {
  std::int64_t unit = 1;
  while (value / static_cast<double>(unit) > largest) unit *= 10;
  return unit;
}

inline void set_homing_methods(Values& of, const drives_joint& joint) {
  int methods = 0;
  for (const int one : Homing::method)
    if (Homing::known(one, joint.index != 0, joint.stops != 0))
      of.set_at(kSlot<0x60E3, 0> + ++methods, one);
  of.set<0x60E3, 0>(methods);
}

inline void set_defaults(Axis& axis, int number) {
  Values& of = axis.values;
  const drives_joint& joint = axis.joint;
  const Units& units = axis.units;
  const double fastest = units.speed(joint.servo.omega_limit);
  const auto round = [](double value) {
    const std::int64_t nearest = to_integer(value, 32);
    return nearest < 1 ? std::int64_t{1} : nearest;
  };
  const double window = 0.01 * fastest, hardest = 8.0 * fastest;
  const std::int64_t of_windows = choose_unit(window, 65535.0);
  const std::int64_t of_accelerations = choose_unit(hardest, 4294967295.0);
  const auto acceleration = [&](double value) {
    const auto in_unit = to_integer(value / static_cast<double>(of_accelerations), 32, false);
    return in_unit < 1 ? std::int64_t{1} : in_unit;
  };
  of.set<0x1018, 4>(number + 1);
  of.set<0x6065>(round(2.0 * fastest / joint.servo.position_gain));
  of.set<0x2007>(of_windows);
  of.set<0x2008>(of_accelerations);
  of.set<0x6067>(round(std::floor(0.01 * static_cast<double>(joint.counts_per_turn))));
  of.set<0x606D>(to_integer(window / static_cast<double>(of_windows), 16, false));
  of.set<0x606F>(to_integer(window / static_cast<double>(of_windows), 16, false));
  of.set<0x6075>(static_cast<std::int64_t>(units.rated_current));
  of.set<0x6076>(static_cast<std::int64_t>(units.rated_torque));
  of.set<0x607D, 1>(joint.lower);
  of.set<0x607D, 2>(joint.upper);
  of.set<0x607F>(round(std::floor(fastest)));
  of.set<0x6080>(to_integer(std::ceil(60.0 * joint.servo.omega_limit / kTurn), 32, false));
  of.set<0x6081>(round(0.25 * fastest));
  of.set<0x6083>(acceleration(2.0 * fastest));
  of.set<0x6084>(acceleration(2.0 * fastest));
  of.set<0x6085>(acceleration(hardest));
  of.set<0x608F, 1>(joint.counts_per_turn);
  of.set<0x6092, 1>(joint.counts_per_turn);
  of.set<0x6099, 1>(round(0.1 * fastest));
  of.set<0x6099, 2>(round(0.02 * fastest));
  of.set<0x609A>(acceleration(fastest));
  of.set<0x60C5>(4294967295);
  of.set<0x60C6>(4294967295);
  if (!axis.interpolation_given) set_interpolation_time(of, axis.cycle ? axis.cycle : axis.period);
  of.set<0x6402>(joint.motor_type);
  of.set<0x6502>(joint.modes);
  set_homing_methods(of, joint);
}

}  // namespace fieldbus
