// Whether a number is one. Reads bit patterns, since a scene's unit is compiled for finite
// arithmetic and may take a comparison with NaN as it likes.
#pragma once

#include <bit>
#include <cstdint>

namespace arm {

inline bool is_finite(double x) { return (std::bit_cast<std::uint64_t>(x) >> 52 & 0x7ff) != 0x7ff; }

}  // namespace arm
