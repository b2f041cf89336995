// Hysteresis of an elastic gear: n springs beside the gear's own that bend with its twist w and
// slip one after the other (Maxwell-slip elements of Iwan's uniform distribution):
//
//   T_h = sum k clamp(w - a_i, d_i)      d_i = (2 i - 1) / (2 n) twist      k = 2 F / (n twist)
//
// With many elements a first loading is F (2 u - u^2), u = w / twist <= 1; after a reversal the
// same curve at twice the size follows (Masing), and closed loops return to where they began.
//
// The anchors a_i are states that no rate moves: while the twist goes one way, T_h is a function of
// w alone. At the start of each step an anchor follows its element as far as it has slipped. That
// is exact however long the step is, and needs no events. Scheme's order 2 remains, since T_h is
// continuous, and its rate, too, where w reverses.
#pragma once

#include <type_traits>

#include "numerics/number.hpp"

namespace arm {

template <int n>
struct Hysteresis {
  constexpr bool operator==(const Hysteresis&) const = default;

  Real F;      // N m at the link, when all elements slip
  Real twist;  // rad at the link, beyond which all slip

  // Stiffness while none slips, and of each [N m/rad].
  constexpr Real stiffness() const { return 2.0 * F / twist; }
  constexpr Real element_stiffness() const { return stiffness() / n; }
  // Twist at which element i of 0 to n - 1 slips [rad].
  constexpr Real limit(int i) const { return (2 * i + 1) * (twist / (2 * n)); }

  template <class X>
  ARM_INLINE constexpr X deflection(int i, X w, const X* anchors) const {
    const X bent = w - anchors[i], most = X{} + limit(i);
    return select(bent > most, most, select(bent < -most, -most, bent));
  }
  template <class X>
  ARM_INLINE constexpr X torque(X w, const X* anchors) const {
    X sum{};
    for (int i = 0; i < n; ++i) sum += deflection(i, w, anchors);
    return element_stiffness() * sum;
  }
  template <class X>
  ARM_INLINE constexpr X stored_energy(X w, const X* anchors) const {
    X sum{};
    for (int i = 0; i < n; ++i) {
      const X bent = deflection(i, w, anchors);
      sum += bent * bent;
    }
    return 0.5 * element_stiffness() * sum;
  }
  constexpr Real dissipated_power(Real w, Real rate, const Real* anchors) const {
    Real sum = 0.0;
    for (int i = 0; i < n; ++i) {
      const Real bent = w - anchors[i];
      if (magnitude(bent) >= limit(i) && bent * rate > 0.0) sum += limit(i) * magnitude(rate);
    }
    return element_stiffness() * sum;
  }
  constexpr void update_anchors(Real w, Real* anchors) const {
    for (int i = 0; i < n; ++i) anchors[i] = w - deflection(i, w, anchors);
  }
};

// A gear with hysteresis. `slips` false: as if no element slipped, which is linear if the gear is.
template <class Gear, int n, bool slips = true>
struct HystereticGear : Gear {
  // g++ 11 leaves the base out of a defaulted comparison.
  constexpr bool operator==(const HystereticGear& other) const {
    return Gear::operator==(other) && hysteresis == other.hysteresis;
  }

  Hysteresis<n> hysteresis;

  static constexpr int states = Gear::states + n;  // the anchors after those of the rotor
  static constexpr bool remembers = true;  // torque, energy and losses depend on the anchors

  constexpr auto linear() const {
    using Linear = std::remove_cvref_t<decltype(Gear::linear())>;
    return HystereticGear<Linear, n, false>{Gear::linear(), hysteresis};
  }

  // Its torque beyond the linear one depends on the anchors, too.
  template <class X>
  void beyond_linear(X, X) const = delete;

  template <class X>
  ARM_INLINE constexpr X torque(X tm, X wm, X q, X v, X offset, bool active,
                                const X* anchors) const {
    const X T = Gear::torque(tm, wm, q, v, offset, active), w = twist(tm, q);
    if constexpr (slips)
      return T + torque_on_link(q, hysteresis.torque(w, anchors));
    else
      return T + hysteresis.stiffness() * w;
  }
  template <class X>
  ARM_INLINE constexpr X stored_energy(X tm, X q, const X* anchors) const {
    return Gear::stored_energy(tm, q) + hysteresis.stored_energy(twist(tm, q), anchors);
  }
  constexpr Real dissipated_power(Real tm, Real wm, Real q, Real v, bool active,
                                  const Real* anchors) const {
    return Gear::dissipated_power(tm, wm, q, v, active) +
           hysteresis.dissipated_power(twist(tm, q), twist_rate(tm, wm, q, v), anchors);
  }
  constexpr void update_memory(Real tm, Real q, Real* anchors) const {
    hysteresis.update_anchors(twist(tm, q), anchors);
  }

 private:
  // The twist; a gear whose teeth have errors states its own (kinematic_error.hpp).
  template <class X>
  ARM_INLINE constexpr X twist(X tm, X q) const {
    if constexpr (requires(const Gear& gear) { gear.twist(tm, q); })
      return Gear::twist(tm, q);
    else
      return this->Ng * tm - q;
  }
  template <class X>
  ARM_INLINE constexpr X twist_rate(X tm, X wm, X q, X v) const {
    if constexpr (requires(const Gear& gear) { gear.twist(tm, q); })
      return Gear::twist_rate(tm, wm, q, v);
    else
      return this->Ng * wm - v;
  }
  // Torque on the link from the torque F along the twist.
  template <class X>
  ARM_INLINE constexpr X torque_on_link(X q, X F) const {
    if constexpr (requires(const Gear& gear) { gear.torque_on_link(q, F); })
      return Gear::torque_on_link(q, F);
    else
      return F;
  }
};

}  // namespace arm
