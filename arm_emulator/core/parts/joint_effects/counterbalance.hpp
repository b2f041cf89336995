// A spring between the link and its parent, such as a gas spring that balances the weight of an
// arm.
//
// One end is at the distance a from the joint's axis, the other, on the link, at b; at q = phi they
// are on the same side of it. The spring has the length l and the force F, > 0 if it pushes:
//
//   l^2 = a^2 + b^2 - 2 a b cos(q - phi)      T = F dl/dq
//   F = F0 - k (l - l0)                       of a straight characteristic
//   F = F0 h / (h + sign(F0) (l - l0))        of a gas column that is h long at l0, at one
//                                             temperature (Boyle)
//
// It dissipates nothing. Its energy is the work from its least strained length, the greatest or the
// smallest one, to l.
#pragma once

#include "numerics/exponential.hpp"
#include "numerics/number.hpp"
#include "numerics/sincos.hpp"
#include "parts/joint_effects/no_torque.hpp"

namespace arm {

// It is soft against the inertia that it balances.
struct Counterbalance : NoTorque<Place::link> {
  constexpr bool operator==(const Counterbalance&) const = default;

  Real a, b;  // m
  Real phi;   // rad
  Real F0;    // N, at the length l0
  Real l0;    // m
  Real k;     // N/m
  Real h;     // m; 0: a straight characteristic

  template <class X>
  ARM_INLINE constexpr X torque(X q, X, const X*, X, bool) const {
    const auto [sin, cos] = sincos(q - phi);
    const X l = length(cos);
    return force(l) * (a * b) * sin / l;
  }
  template <class X>
  ARM_INLINE constexpr X stored_energy(X q, const X*) const {
    return work(length(sincos(q - phi).cos)) - work(relaxed());
  }

 private:
  constexpr Real compressing() const { return F0 < 0.0 ? -1.0 : 1.0; }
  constexpr Real relaxed() const { return F0 < 0.0 ? magnitude(a - b) : a + b; }
  template <class X>
  ARM_INLINE constexpr X force(X l) const {
    if (h == 0.0) return F0 - k * (l - l0);
    return F0 * h / (h + compressing() * (l - l0));
  }
  template <class X>
  ARM_INLINE constexpr X length(X cos) const {
    return square_root(X((a * a + b * b) - 2.0 * a * b * cos));
  }
  // dwork/dl = -F.
  template <class X>
  ARM_INLINE constexpr X work(X l) const {
    if (h == 0.0) return (l - l0) * (0.5 * k * (l - l0) - F0);
    X beside = 1.0 + compressing() * (l - l0) / h;
    if constexpr (kWidth<X> == 1) {
      beside = logarithm(beside);
    } else {
      for (int lane = 0; lane < kWidth<X>; ++lane)
        set_lane(beside, lane, logarithm(lane_of(beside, lane)));
    }
    return -compressing() * F0 * h * beside;
  }
};

}  // namespace arm
