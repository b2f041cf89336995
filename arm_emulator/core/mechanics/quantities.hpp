// Quantities measured by sensors, an entry per joint. A quantity of a new sensor is a struct like
// these, in a header of its own.
#pragma once

namespace arm {

// Place of a quantity in arm.h: a field of its own, or among the readings.
enum class Field { current, torque, reading };

// A machine at the moment at which its sensors look, with what was worked out for all of them.
template <class Machine>
struct Glance {
  static constexpr int N = Machine::N;
  const Machine& machine;
  const double *current, *motor_angle, *motor_speed;  // A, rad, rad/s
};

struct MotorCurrent {  // A
  static constexpr Field field = Field::current;
  template <class Glance>
  static void of(const Glance& now, double* row) {
    for (int j = 0; j < now.N; ++j) row[j] = now.current[j];
  }
};

struct GearTorque {  // N m or N, on the link
  static constexpr Field field = Field::torque;
  template <class Glance>
  static void of(const Glance& now, double* row) {
    now.machine.gear_torques(row);
  }
};

}  // namespace arm
