// Initial values of a drive's dictionary that depend on its joint, beyond the standard values of
// the table.
#pragma once

#include "axis.hpp"
#include "homing.hpp"

namespace fieldbus {

inline void set_interpolation_time(Values& of, double period) {
  int value = static_cast<int>(1e3 * period + 0.5), exponent = -3;
  if (value < 1 || value > 255 || std::fabs(1e-3 * value - period) > 1e-9) {
    value = 1;  // as near as it gets: less than a period is a period
    exponent = -6;
  }
  of.set<0x60C2, 1>(value);
  of.set<0x60C2, 2>(exponent);
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
  const auto whole = [](double value) {
    const std::int64_t nearest = to_integer(value, 32);
    return nearest < 1 ? std::int64_t{1} : nearest;
  };
  of.set<0x1018, 4>(number + 1);
  of.set<0x6065>(whole(2.0 * fastest / joint.servo.position_gain));
  of.set<0x606D>(to_integer(0.01 * fastest, 16, false));
  of.set<0x606F>(to_integer(0.01 * fastest, 16, false));
  of.set<0x6075>(static_cast<std::int64_t>(units.rated_current));
  of.set<0x6076>(static_cast<std::int64_t>(units.rated_torque));
  of.set<0x607D, 1>(joint.lower);
  of.set<0x607D, 2>(joint.upper);
  of.set<0x607F>(whole(std::floor(fastest)));
  of.set<0x6080>(to_integer(std::ceil(60.0 * joint.servo.omega_limit / kTurn), 32, false));
  of.set<0x6081>(whole(0.25 * fastest));
  of.set<0x6083>(whole(2.0 * fastest));
  of.set<0x6084>(whole(2.0 * fastest));
  of.set<0x6085>(whole(8.0 * fastest));
  of.set<0x608F, 1>(joint.counts_per_turn);
  of.set<0x6092, 1>(joint.counts_per_turn);
  of.set<0x6099, 1>(whole(0.1 * fastest));
  of.set<0x6099, 2>(whole(0.02 * fastest));
  of.set<0x609A>(whole(fastest));
  of.set<0x60C5>(4294967295);
  of.set<0x60C6>(4294967295);
  set_interpolation_time(of, axis.dt);
  of.set<0x6502>(joint.modes);
  set_homing_methods(of, joint);
}

}  // namespace fieldbus
