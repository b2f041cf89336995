// Dry friction of a rotor behind an elastic gear (behind a rigid gear it acts on the link).
//
// Its mode is `active` where the rotor sticks: then 0 = wm replaces eq. (2). Else the mode's number
// is the sliding torque, with the sign of the motion; of a law that knows the direction of power it
// is +-1 where the motor's torque is the greater one, and else +-2. `Law` is any law with the
// interface of friction.hpp; a law without dry friction has the regular mode only.
#pragma once

#include "parts/frictions/friction.hpp"
#include "parts/mode.hpp"

namespace arm {

// Torques on a rotor, beside its friction.
struct RotorTorques {
  constexpr bool operator==(const RotorTorques&) const = default;

  Real torque;    // N m, of all
  Real of_gear;   // N m, of the gear alone
  Real rounding;  // N m, uncertainty by rounding of angles
  FrictionFactors<Real> factors = {};

  constexpr Real of_motor() const { return torque + of_gear; }
};

template <class Law = Friction>
struct RotorFriction {
  constexpr bool operator==(const RotorFriction&) const = default;

  Law law;

  static constexpr int modes = 1;
  static constexpr bool varies = Law::varies, loaded = Law::loaded, directed = Law::directed;
  constexpr auto linear() const {
    return RotorFriction<std::remove_cvref_t<decltype(law.linear())>>{law.linear()};
  }

  // Torque against the motion, viscous and dry, while it slides by `offset`, under the torques of
  // the gear and of the motor.
  template <class X>
  ARM_INLINE constexpr X resisting_torque(X wm, [[maybe_unused]] X of_gear,
                                          [[maybe_unused]] X of_motor, X offset,
                                          const FrictionFactors<X>& factors = {}) const {
    if constexpr (varies) {
      const X dry = law.sliding_torque(wm, make_shaft_torques(of_gear, of_motor, offset, factors));
      return viscous_torque(law, wm, factors) +
             select(offset < 0.0, -dry, select(offset > 0.0, dry, X{}));
    } else {
      return law.Dv * wm + offset;
    }
  }
  template <class X>
  ARM_INLINE constexpr X dissipated_power(X wm, X of_gear, X of_motor, X offset,
                                          const FrictionFactors<X>& factors = {}) const {
    return viscous_torque(law, wm, factors) * wm +
           law.sliding_torque(wm, make_shaft_torques(of_gear, of_motor, offset, factors)) *
               magnitude(wm);
  }

  constexpr bool is_regular() const { return is_free(); }
  constexpr Mode mode_at(Real wm, const RotorTorques& on) const {
    if (is_free()) return {};
    if (wm == 0.0 && holding_margin(on) >= 0.0) return {true, 0.0};
    return sliding_mode(wm == 0.0 ? on.torque : wm, wm, on);
  }
  constexpr Mode required_mode(Real began, Real wm, const RotorTorques& on,
                               const Mode& mode) const {
    if (mode.active) return holding_margin(on) >= 0.0 ? mode : sliding_mode(on.torque, 0.0, on);
    if (is_free()) return mode;
    // A rotor that reverses rests at the step's end, or in the whole step if it stopped in the
    // first half: longer friction would wind up the gear.
    const bool stops_early = magnitude(began) < magnitude(wm);
    return wm * mode.offset < 0.0 && stops_early ? Mode{true, 0.0} : mode;
  }
  constexpr Real margin(Real wm, const RotorTorques& on, const Mode& mode) const {
    if (mode.active) return holding_margin(on);
    if (is_free()) return 1.0;
    const Real onward = mode.offset < 0.0 ? -wm : wm;
    if constexpr (directed)
      if (law.has_jump()) {
        const Real same = lead_sign(mode.offset) * power_excess(on.of_gear, on.of_motor());
        return same < onward ? same : onward;
      }
    return onward;
  }
  constexpr void enforce_modes(Real& wm, const Mode& mode) const {
    if (mode.active || (!is_free() && wm * mode.offset < 0.0)) wm = 0.0;
  }

 private:
  constexpr bool is_free() const { return !law.is_dry(); }
  // By how much the motor's torque is the greater one [N m], and its sign from the mode's number.
  template <class X>
  ARM_INLINE static constexpr X power_excess(X of_gear, X of_motor) {
    return magnitude(of_motor) - magnitude(of_gear);
  }
  template <class X>
  ARM_INLINE static constexpr X lead_sign(X offset) {
    return select(magnitude(offset) > 1.5, X{} - 1.0, X{} + 1.0);
  }
  template <class X>
  ARM_INLINE static constexpr ShaftTorques<X> make_shaft_torques(
      X of_gear, X of_motor, X offset, const FrictionFactors<X>& factors) {
    if constexpr (!directed) return {of_gear, of_motor, X{}, factors};
    const X sign = select(offset < 0.0, X{} - 1.0, X{} + 1.0);
    return {sign * of_gear, sign * of_motor, lead_sign(offset), factors};
  }
  static constexpr ShaftTorques<Real> torques_toward(Real sign, const RotorTorques& on) {
    return make_shaft_torques(on.of_gear, on.of_motor(), make_offset(sign, on), on.factors);
  }
  static constexpr Real make_offset(Real sign, const RotorTorques& on) {
    const Real number = power_excess(on.of_gear, on.of_motor()) < 0.0 ? 2.0 : 1.0;
    return sign < 0.0 ? -number : number;
  }
  // Remaining holding torque, below 0 if it does not hold [N m].
  constexpr Real holding_margin(const RotorTorques& on) const {
    return law.holding_torque(torques_toward(on.torque, on)) * (1.0 + kRounding) + on.rounding -
           magnitude(on.torque);
  }
  constexpr Mode sliding_mode(Real sign, Real wm, const RotorTorques& on) const {
    if constexpr (directed) return {false, make_offset(sign, on)};
    // The sign is the direction of motion, also for a torque of 0.
    const Real dry = law.sliding_torque(wm, torques_toward(sign, on));
    const Real some = dry > 0.0 ? dry : 1e-300;
    return {false, sign < 0.0 ? -some : some};
  }
};

// A rotor without friction.
struct FreeRotor {
  constexpr bool operator==(const FreeRotor&) const = default;

  static constexpr int modes = 0;
  static constexpr bool varies = false, loaded = false, directed = false;
  constexpr const FreeRotor& linear() const { return *this; }
};

}  // namespace arm
