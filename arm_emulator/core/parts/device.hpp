// Devices of a joint's drive beside motor and gear, and the names of sensors.
#pragma once

#include "numerics/real.hpp"

namespace arm {

struct Device {
  const char* name;
  Real counts_per_rad;  // encoder counts at the motor
};

// A row of arm_command.further: which of the motor's further inputs it is at each joint, from 0 on;
// -1 where the motor has none of that name.
template <int N>
struct FurtherInput {
  const char* name;
  int of[N];
  const char* unit[N];
};

// A row of arm_measurement.readings.
struct Reading {
  const char *name, *unit, *unit_of_slides;
};

}  // namespace arm
