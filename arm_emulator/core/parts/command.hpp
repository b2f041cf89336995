// Quantities commanded to motors, and their bounds.
#pragma once

#include "numerics/number.hpp"

namespace arm {

// As in arm.h, enum arm_mode.
enum class Command { voltage = 1, torque = 2, current = 4, voltage_dq = 8 };

// A limit of 0 does not limit.
constexpr Real limit_or_none(Real limit) { return limit > 0.0 ? limit : 1e300; }

// Rate of a first-order lag of a bandwidth [Hz]; 0: no lag.
constexpr Real time_constant(Real bandwidth) {
  return bandwidth > 0.0 ? 1.0 / (2.0 * 3.14159265358979323846 * bandwidth) : 0.0;
}

// The larger size of two numbers.
template <class X>
ARM_INLINE constexpr X larger_size(X a, X b) {
  const X size_a = magnitude(a), size_b = magnitude(b);
  return select(size_a < size_b, size_b, size_a);
}

}  // namespace arm
