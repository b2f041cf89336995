// The speed of a joint's link, which a tachometer measures.
#pragma once

#include "mechanics/quantities.hpp"
#include "numerics/real.hpp"

namespace arm {

struct LinkSpeed {  // rad/s or m/s
  static constexpr Field field = Field::reading;
  template <class Glance>
  static void of(const Glance& now, Real* row) {
    for (int j = 0; j < now.N; ++j) row[j] = now.machine.state().v[j];
  }
};

}  // namespace arm
