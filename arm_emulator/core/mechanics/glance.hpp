// A look of the sensors at a machine. The classes of sensors state in Python what they read of it
// (`reads`), from which a scene's unit has a struct per kind: `field`, and `of(now, row)`.
#pragma once

#include <array>

namespace arm {

// Place of a quantity in arm.h: a field of its own, or among the readings.
enum class Field { current, torque, reading };

// A machine at the moment of the look, with what was worked out for all sensors, by joint.
template <class Machine>
struct Glance {
  static constexpr int N = Machine::N;
  const Machine& machine;
  const double *current, *motor_angle, *motor_speed;  // A, rad, rad/s

  // Torques of the gears on their links [N m or N].
  std::array<double, N> gear_torques() const {
    std::array<double, N> torques;
    machine.gear_torques(torques.data());
    return torques;
  }
  // Temperatures of the motors' windings [degC].
  std::array<double, N> winding_temperatures() const {
    std::array<double, N> temperatures;
    machine.winding_temperatures(temperatures.data());
    return temperatures;
  }
};

}  // namespace arm
