// The speed of a motor's shaft, which a tachometer on it measures.
#pragma once

#include "mechanics/quantities.hpp"
#include "numerics/real.hpp"

namespace arm {

struct MotorSpeed {  // rad/s
  static constexpr Field field = Field::reading;
  template <class Glance>
  static void of(const Glance& now, Real* row) {
    for (int j = 0; j < now.N; ++j) row[j] = now.motor_speed[j];
  }
};

}  // namespace arm
