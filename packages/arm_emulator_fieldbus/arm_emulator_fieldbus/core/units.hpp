// Between the units of the dictionary and those of the servo.
#pragma once

#include <cmath>
#include <cstdint>

#include "servo.h"

namespace fieldbus {

inline constexpr double kTurn = 6.283185307179586476925286766559;

// Counts at the motor are numbered; the angle of count N is its middle, N + 1/2.
struct Units {
  double count_angle;    // rad of the motor
  double ratio;          // link turns per motor turn
  double torque;         // N m of the motor per 0.1 %
  double current;        // A per 0.1 % of torque
  double rated_torque;   // mN m, a whole number
  double rated_current;  // mA, a whole number

  // Rated is what the servo's current limit gives, or the supply on the winding at rest where it
  // has none: scenes has no other.
  explicit Units(const servo_joint& joint) {
    count_angle = joint.count_angle;
    ratio = joint.ratio;
    const double stall = joint.voltage_limit / (joint.current_voltage - joint.winding);
    const double amperes = joint.current_limit < stall ? joint.current_limit : stall;
    rated_torque = whole(1e3 * amperes * joint.torque_constant);
    rated_current = whole(rated_torque / joint.torque_constant);
    torque = 1e-6 * rated_torque;
    current = torque / joint.torque_constant;
  }

  double omega(double counts_per_s) const { return counts_per_s * count_angle; }
  double speed(double omega) const { return omega / count_angle; }
  // Link angle in the middle of a count.
  double q(double counts) const { return (counts + 0.5) * count_angle * ratio; }
  double v(double counts_per_s) const { return counts_per_s * count_angle * ratio; }
  // Torque of the link for one of the motor in 0.1 %.
  double tau(double per_mille) const { return per_mille * torque / ratio; }

 private:
  static double whole(double value) {
    const double down = std::floor(value);
    return down < 1.0 ? 1.0 : down > 4294967295.0 ? 4294967295.0 : down;
  }
};

// The nearest whole number that an entry of so many bits holds.
inline std::int64_t to_integer(double value, int bits, bool with_sign = true) {
  const double high = std::ldexp(1.0, with_sign ? bits - 1 : bits) - 1.0;
  const double low = with_sign ? -high - 1.0 : 0.0;
  if (!(value > low)) return static_cast<std::int64_t>(low);
  if (!(value < high)) return static_cast<std::int64_t>(high);
  return static_cast<std::int64_t>(std::floor(value + 0.5));
}

// A position that goes on beyond 32 bits, from one of 32 bits that is near another.
inline std::int64_t near(std::int64_t position, std::int64_t word) {
  const auto ahead = static_cast<std::uint32_t>(word) -
                     static_cast<std::uint32_t>(static_cast<std::uint64_t>(position));
  return position + static_cast<std::int32_t>(ahead);
}
// The low 32 bits, as masters read them.
inline std::int64_t word_of(std::int64_t position) {
  return static_cast<std::int32_t>(
      static_cast<std::uint32_t>(static_cast<std::uint64_t>(position)));
}

}  // namespace fieldbus
