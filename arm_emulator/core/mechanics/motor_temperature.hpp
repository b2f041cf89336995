// The temperature of a motor's winding, which a thermometer in it measures.
#pragma once

#include "mechanics/quantities.hpp"
#include "numerics/real.hpp"

namespace arm {

struct MotorTemperature {  // degC
  static constexpr Field field = Field::reading;
  template <class Glance>
  static void of(const Glance& now, Real* row) {
    now.machine.winding_temperatures(row);
  }
};

}  // namespace arm
