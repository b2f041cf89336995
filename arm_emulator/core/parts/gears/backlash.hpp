// An elastic gear with play: while the twist w = Ng tm - q is within +-play/2 no tooth touches and
// T = 0; beyond, a tooth pushes (unilateral_spring.hpp) with the depth |w| - play/2.
//
// Its mode is `active` while a tooth pushes, and the mode's number is the twist where it began to
// touch: then T = Kg (w - offset) + Dg dw/dt.
//
// A play of 0 is the elastic gear, whose damper pulls, too: always `active`, with offset 0. Teeth
// that push and never pull would meet an event at each change of the torque's sign.
#pragma once

#include "parts/gears/gear.hpp"
#include "parts/mode.hpp"
#include "parts/unilateral_spring.hpp"

namespace arm {

struct BacklashGear {
  constexpr bool operator==(const BacklashGear&) const = default;

  Real Ng;    // link turns per motor turn
  Real Kg;    // N m/rad at the link
  Real Dg;    // N m s/rad at the link
  Real play;  // rad at the link, from tooth to tooth

  static constexpr bool rigid = false;
  static constexpr int states = ElasticGear::states;
  static constexpr int modes = 1;
  constexpr const BacklashGear& linear() const { return *this; }

  template <class X>
  ARM_INLINE constexpr X torque(X tm, X wm, X q, X v, X offset, bool active) const {
    return active ? tooth().push_torque(Ng * tm - q - offset, Ng * wm - v) : X{};
  }
  template <class X>
  ARM_INLINE constexpr X stored_energy(X tm, X q) const {
    return tooth().stored_energy(magnitude(Ng * tm - q) - gap());
  }
  constexpr Real dissipated_power(Real tm, Real wm, Real q, Real v, bool active) const {
    const Real w = Ng * tm - q, rate = Ng * wm - v;
    if (is_tight()) return Dg * rate * rate;
    return tooth().dissipated_power(magnitude(w) - gap(), w < 0.0 ? -rate : rate, active);
  }

  constexpr Mode mode_at(Real tm, Real wm, Real q, Real v) const {
    if (is_tight()) return {true, 0.0};
    const Real w = Ng * tm - q, rate = Ng * wm - v, sign = w < 0.0 ? -1.0 : 1.0;
    if (tooth().is_pushing(sign * w - gap(), sign * rate)) return {true, sign * gap()};
    return {};
  }
  constexpr Real margin(Real tm, Real wm, Real q, Real v, const Mode& mode) const {
    if (is_tight()) return 1.0;
    const Real w = Ng * tm - q, rate = Ng * wm - v;
    // While no tooth pushes, the margin is that of the nearer one.
    const Real sign = (mode.active ? mode.offset : w) < 0.0 ? -1.0 : 1.0;
    return tooth().margin(mode.active, sign * w - gap(), sign * rate,
                          kRounding * Kg * (gap() + magnitude(q)));
  }

 private:
  constexpr bool is_tight() const { return play == 0.0; }
  constexpr Real gap() const { return 0.5 * play; }
  constexpr UnilateralSpring tooth() const { return {Kg, Dg}; }
};

}  // namespace arm
