// Stops at both ends of a joint: beyond `lower` or `upper` a spring and a damper push the link back
// and never hold it (one_sided.hpp).
//
// Its mode is `held` while a stop pushes; the mode's number is the position of that stop.
#pragma once

#include "parts/mode.hpp"
#include "parts/one_sided.hpp"
#include "parts/place.hpp"

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
  ARM_INLINE constexpr X torque(X q, X v, const X*, X offset, bool held) const {
    return held ? -stop().push(q - offset, v) : X{};
  }
  template <class X>
  ARM_INLINE constexpr X stored(X q, const X*) const {
    return stop().stored(q - upper) + stop().stored(lower - q);
  }
  constexpr Real dissipated(Real q, Real v, const Real*, bool held) const {
    const bool above = q - upper > lower - q;
    return above ? stop().dissipated(q - upper, v, held) : stop().dissipated(lower - q, -v, held);
  }

  template <class X>
  ARM_INLINE constexpr Mask<X> is_usual(X q, X, const X*) const {
    return (q <= upper) & (q >= lower);
  }
  constexpr Mode mode_at(Real q, Real v, const Real*) const {
    if (stop().pushes(q - upper, v)) return {true, upper};
    if (stop().pushes(lower - q, -v)) return {true, lower};
    return {};
  }
  constexpr Real margin(Real q, Real v, const Real*, const Mode& mode) const {
    // While no stop pushes, the margin is that of the nearer one.
    const bool above = mode.held ? mode.offset == upper : q - upper > lower - q;
    const Real u = above ? q - upper : lower - q, du = above ? v : -v;
    const Real size = magnitude(lower) + magnitude(upper);
    return stop().margin(mode.held, u, du, kRounding * K * size);
  }

 private:
  constexpr OneSided stop() const { return {K, D}; }
};

}  // namespace arm
