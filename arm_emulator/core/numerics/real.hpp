// Numbers of the machine: `double`; or, in a library for sensitivities, numbers that carry their
// derivatives in some directions through every operation of the same source.
#pragma once

#include "numerics/dual.hpp"

namespace arm {

#ifdef ARM_DIRECTIONS
using Real = Dual<ARM_DIRECTIONS>;
#else
using Real = double;
#endif

// Whether they carry derivatives.
inline constexpr bool kDifferentiates = !std::is_same_v<Real, double>;

// Whether machines keep what their motions were made of (schemes/step_segments.hpp).
#ifdef ARM_RECORDS
inline constexpr bool kRecords = true;
#else
inline constexpr bool kRecords = false;
#endif

}  // namespace arm
