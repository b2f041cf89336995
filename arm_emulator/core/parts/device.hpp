// What is fixed to a joint's drive beside motor and gear.
#pragma once

namespace arm {

struct Device {
  const char* name;
  double counts_per_rad;  // encoder counts at the motor
};

}  // namespace arm
