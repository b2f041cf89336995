// Friction by bristles that bend by z before they slip: a shaft yields like a spring before it
// slides, which Coulomb friction neglects.
//
//   dz/dt = w - s0 |w| z / g(w)      g(w) = Dc + (Ds - Dc) exp(-(w / vs)^2)
//   torque on the shaft  -s0 z - s1 dz/dt
//
// C. Canudas de Wit, H. Olsson, K. J. Astrom and P. Lischinsky, IEEE Trans. Automatic Control 40,
// 1995; viscous friction has a section of its own.
//
// |w| has a corner where the shaft reverses. The mode's number is the direction of motion, so that
// located events cut steps there; nothing else depends on it.
#pragma once

#include "parts/frictions/stribeck.hpp"
#include "parts/mode.hpp"
#include "parts/place.hpp"

namespace arm {

template <Place where>
struct LuGre {
  constexpr bool operator==(const LuGre&) const = default;

  Real Dc, Ds;  // N m, of sliding fast, and of breaking away
  Real vs;      // rad/s, as of Stribeck
  Real s0;      // N m/rad, of the bristles
  Real s1;      // N m s/rad

  static constexpr Place place = where;
  static constexpr int states = 1, modes = 1;

  // Bristles that only bend: the shaft at rest on its spring and damper.
  struct Spring {
    constexpr bool operator==(const Spring&) const = default;

    Real s0, s1;

    static constexpr Place place = where;
    static constexpr int states = 1, modes = 1;
    constexpr const Spring& linear() const { return *this; }
    template <class X>
    ARM_INLINE constexpr void rates(X, X w, const X*, X* f) const {
      f[0] = w;
    }
    template <class X>
    ARM_INLINE constexpr X torque(X, X w, const X* z, X, bool) const {
      return -s0 * z[0] - s1 * w;
    }
  };
  constexpr Spring linear() const { return {s0, s1}; }

  template <class X>
  ARM_INLINE constexpr void rates(X, X w, const X* z, X* f) const {
    f[0] = w - slip(w, z[0]);
  }
  template <class X>
  ARM_INLINE constexpr X torque(X, X w, const X* z, X, bool) const {
    // Bristles never bend far beyond Ds / s0. If they do, the step is too long, and the machine
    // diverges.
    const X limit = X{} + 5.0 * Ds / s0;
    const X bent = select(magnitude(z[0]) > limit, z[0] * 1e30, z[0]);
    return -s0 * bent - s1 * (w - slip(w, z[0]));
  }
  template <class X>
  ARM_INLINE constexpr X stored_energy(X, const X* z) const {
    return 0.5 * s0 * z[0] * z[0];
  }
  constexpr Real dissipated_power(Real, Real w, const Real* z, bool) const {
    const Real rate = w - slip(w, z[0]);
    return (s0 * z[0] + s1 * rate) * w - s0 * z[0] * rate;
  }

  constexpr Mode mode_at(Real, Real w, const Real*) const { return {false, w < 0.0 ? -1.0 : 1.0}; }
  // The direction of a shaft that hardly moves is arbitrary.
  constexpr Real margin(Real, Real w, const Real*, const Mode& mode) const {
    return mode.offset * w + 1e-6 * vs;
  }

 private:
  // The rate at which bristles let go.
  template <class X>
  ARM_INLINE constexpr X slip(X w, X z) const {
    X g{};
    for (int lane = 0; lane < kWidth<X>; ++lane)
      set_lane(g, lane,
               Stribeck{0.0, Dc, Ds, vs}.sliding_torque(lane_of(w, lane), ShaftTorques<Real>{}));
    return s0 * magnitude(w) * z / g;
  }
};

}  // namespace arm
