// The microcontroller's time.
#pragma once

#include <cstdint>
#include <limits>

namespace mcu {

// In 1/256 of a processor cycle since the reset.
using Time = int64_t;
constexpr Time CYCLE = 256;
constexpr Time NEVER = std::numeric_limits<Time>::max();

}  // namespace mcu
