// All values of an instance in one place, so that the table of variables states where each of them
// is. Included after the constants of a scene (unit.py).
#pragma once

#include <cstddef>
#include <cstdint>
#include <type_traits>
#include <utility>

#pragma GCC visibility push(default)
#include "arm.h"
#pragma GCC visibility pop

namespace fmu {

constexpr int N = kJoints, L = kLinks;  // drives; links that move

// Inputs of the machine at a tick.
struct Inputs {
  double command[N], further[kInputs * N + 1];
  double external_force[3 * L], external_moment[3 * L], external_point[3 * L];
  unsigned char enable[N], close_brake[N], power, external_world_axes;
};

// State of an instance beside its machine.
struct Values {
  std::uint64_t mode;
  std::int64_t ticks;      // servo periods that have passed
  double since_tick;       // s
  double clock;            // s, the communication point as the importer computes it
  std::uint64_t underway;  // a servo period has begun, with the inputs `held`
  std::uint64_t retuned;   // parameters have changed since it began
  double start, stop;      // s
  std::uint64_t has_stop;
  std::uint64_t moved;  // the start has changed since the machine was put there
  Inputs now, held;
  double start_q[N], start_v[N];
  double parameter[kParameters + 1];
};

static_assert(sizeof(Values) % 8 == 0);

// Newest measurements.
struct Shown {
  double time;
  arm_joint_measurement joint[N];
  arm_joint_sensors sensors[N];
  arm_imu_measurement imu[kImus + 1];
  double current_d[N];
  double readings[kReadings * N + 1];
  double further[kInputs * N + 1];
  std::uint32_t powered;
};

// The true state, as last requested.
struct Truth {
  double q[N], v[N], gear_torque[N], motor_angle[N], motor_speed[N], current[N];
  double energy, winding_temperature[N], gear_temperature[N];
};

struct Data {
  Values values;
  Shown shown;
  Truth truth;
};

}  // namespace fmu

// The place of a value of `struct Data`, and of those behind it where it is one of an array, whose
// first element is `element`.
#define FMU_PLACE(value, element)                                                \
  fmu::Place {                                                                   \
    fmu::kWire<std::remove_cvref_t<decltype(std::declval<fmu::Data&>().value)>>, \
        offsetof(fmu::Data, value), sizeof(std::declval<fmu::Data&>().element)   \
  }
