// A look of the sensors at a machine. The classes of sensors state in Python what they read of it
// (`reads`), from which a scene's unit has a struct per kind: `field`, and `of(now, row)`.
#pragma once

namespace arm {

// Place of a quantity in arm.h: a field of its own, or among the readings.
enum class Field { current, torque, reading };

// A machine at the moment of the look, with what was worked out for all sensors, by joint.
template <class Machine>
struct SensorInput {
  static constexpr int N = Machine::N;
  const Machine& machine;
  const double *current, *motor_angle, *motor_speed;  // A, rad, rad/s

  struct OfJoints {
    double of[N];
    double operator[](int j) const { return of[j]; }
  };
  // Torques of the gears on their links [N m or N].
  OfJoints gear_torques() const {
    OfJoints torques;
    machine.gear_torques(torques.of);
    return torques;
  }
  // Temperatures of the motors' windings [degC].
  OfJoints winding_temperatures() const {
    OfJoints temperatures;
    machine.winding_temperatures(temperatures.of);
    return temperatures;
  }
};

}  // namespace arm
