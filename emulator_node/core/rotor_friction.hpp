// Dry friction of a rotor behind an elastic gear (of one behind a rigid gear it is the link's).
//
// Its mode is `held` where the rotor is stuck: then 0 = wm takes the place of eq. (2). Else it
// slides, and the mode's number is the torque of sliding, with the sign of the motion. Any law of
// friction.hpp's kind can be `Law`.
#pragma once

#include "friction.hpp"
#include "mode.hpp"

namespace arm {

template <class Law = Friction>
struct RotorFriction {
  Law law;

  static constexpr int modes = 1;
  static constexpr bool varies = Law::varies;
  constexpr auto linear() const {
    return RotorFriction<std::remove_cvref_t<decltype(law.linear())>>{law.linear()};
  }

  // Torque against the motion, viscous and dry, while it slides as `offset` says.
  template <class X>
  ARM_INLINE constexpr X against(X wm, [[maybe_unused]] X T, X offset) const {
    if constexpr (varies) {
      const X dry = law.sliding(wm, T);
      return law.Dv * wm + select(offset < 0.0, -dry, select(offset > 0.0, dry, X{}));
    } else {
      return law.Dv * wm + offset;
    }
  }
  template <class X>
  ARM_INLINE constexpr X dissipated(X wm, X T) const {
    return law.Dv * wm * wm + law.sliding(wm, T) * magnitude(wm);
  }

  constexpr bool is_usual() const { return is_free(); }
  // `torque`: what the rotor feels beside friction; T: that of the gear on the rotor.
  constexpr Mode mode_at(double wm, double torque, double T) const {
    if (is_free()) return {};
    if (wm == 0.0 && magnitude(torque) <= law.holding(T) * (1.0 + kRounding)) return {true, 0.0};
    return slide(wm == 0.0 ? torque : wm, wm, T);
  }
  constexpr Mode wanted(double began, double wm, double torque, double T, const Mode& mode) const {
    if (mode.held)
      return magnitude(torque) <= law.holding(T) * (1.0 + kRounding) ? mode : slide(torque, 0.0, T);
    if (is_free()) return mode;
    // A rotor that reverses comes to rest at the step's end; one that was at rest has not left it.
    return began == 0.0 && wm * mode.offset < 0.0 ? Mode{true, 0.0} : mode;
  }
  constexpr double margin(double wm, double torque, double T, const Mode& mode) const {
    if (mode.held) return law.holding(T) * (1.0 + kRounding) - magnitude(torque);
    if (is_free()) return 1.0;
    return mode.offset < 0.0 ? -wm : wm;
  }
  constexpr void settle(double& wm, const Mode& mode) const {
    if (mode.held || (!is_free() && wm * mode.offset < 0.0)) wm = 0.0;
  }

 private:
  constexpr bool is_free() const {
    if constexpr (requires { law.is_free(); }) return law.is_free();
    return false;
  }
  constexpr Mode slide(double way, double wm, double T) const {
    // The way is kept in the sign, also of a torque of 0.
    const double dry = law.sliding(wm, T);
    const double some = dry > 0.0 ? dry : 1e-300;
    return {false, way < 0.0 ? -some : some};
  }
};

// A rotor without.
struct FreeRotor {
  static constexpr int modes = 0;
  static constexpr bool varies = false;
  constexpr const FreeRotor& linear() const { return *this; }
};

}  // namespace arm
