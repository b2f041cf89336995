// Stops at both ends of a joint: beyond `lower` or `upper` a spring and a damper push the link back
// and never hold it (unilateral_spring.hpp).
//
// Its mode is `active` while a stop pushes; the mode's number is the position of that stop.
#pragma once

#include "parts/mode.hpp"
#include "parts/place.hpp"
#include "parts/unilateral_spring.hpp"

namespace arm {

struct EndStops {
  constexpr bool operator==(const EndStops&) const = default;

  Real lower, upper;  // rad (m)
  Real K;             // N m/rad
  Real D;             // N m s/rad

  static constexpr Place place = Place::link;
  static constexpr int states = 0, modes = 1;
  constexpr const EndStops& linear() const { return *this; }

  template <class X>
  ARM_INLINE constexpr X torque(X q, X v, const X*, X offset, bool active) const {
    return active ? -stop().push_torque(q - offset, v) : X{};
  }
  template <class X>
  ARM_INLINE constexpr X stored_energy(X q, const X*) const {
    return stop().stored_energy(q - upper) + stop().stored_energy(lower - q);
  }
  constexpr Real dissipated_power(Real q, Real v, const Real*, bool active) const {
    const bool above = q - upper > lower - q;
    return above ? stop().dissipated_power(q - upper, v, active)
                 : stop().dissipated_power(lower - q, -v, active);
  }

  template <class X>
  ARM_INLINE constexpr Mask<X> is_regular(X q, X, const X*) const {
    return (q <= upper) & (q >= lower);
  }
  constexpr Mode mode_at(Real q, Real v, const Real*) const {
    if (stop().is_pushing(q - upper, v)) return {true, upper};
    if (stop().is_pushing(lower - q, -v)) return {true, lower};
    return {};
  }
  constexpr Real margin(Real q, Real v, const Real*, const Mode& mode) const {
    // While no stop pushes, the margin is that of the nearer one.
    const bool above = mode.active ? mode.offset == upper : q - upper > lower - q;
    const Real u = above ? q - upper : lower - q, du = above ? v : -v;
    const Real size = magnitude(lower) + magnitude(upper);
    return stop().margin(mode.active, u, du, kRounding * K * size);
  }

 private:
  constexpr UnilateralSpring stop() const { return {K, D}; }
};

}  // namespace arm
