// Replaces a soft part without states in the matrix A of the schemes, which it does not stiffen;
// and base of such parts, which need to declare their torque only.
#pragma once

#include "numerics/number.hpp"
#include "parts/place.hpp"

// A scene names the numbers of a part alone, not this base without any.
#pragma GCC diagnostic ignored "-Wmissing-field-initializers"

namespace arm {

template <Place where>
struct NoTorque {
  constexpr bool operator==(const NoTorque&) const = default;

  static constexpr Place place = where;
  static constexpr int states = 0, modes = 0;
  constexpr const NoTorque& linear() const { return *this; }
  template <class X>
  ARM_INLINE constexpr X torque(X, X, const X*, X, bool) const {
    return X{};
  }
  template <class X>
  ARM_INLINE constexpr X stored_energy(X, const X*) const {
    return X{};
  }
  constexpr Real dissipated_power(Real, Real, const Real*, bool) const { return 0.0; }
};

}  // namespace arm
