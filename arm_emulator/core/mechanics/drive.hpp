// The drive of one joint: the equations from its command u to the torque T on its link. With local
// states z, the link's q and v:
//
//   D dz/dt = f(z, q, v, u)      torque on the link  g(z, q, v) - carried dv/dt
//
// D may have zeros: no inductance, a current at its limit, a stuck rotor. Schemes, energy balance
// and reports derive their data from it (drive_table.hpp, modes.hpp, energy.hpp).
//
// A drive is composed of parts: a motor, a gear, friction of link and rotor, and any number of
// extras that act on either (place.hpp). docs/concepts/parts.md lists what a part declares.
//
// `linear()` of each part returns a linear part for the matrix A of the schemes: itself if it is
// linear. The difference is the drive's nonlinear part, which enters each stage
// (linearly_implicit.hpp). Non-smooth behaviour is a mode of its part (mode.hpp).
// One template joins all parts, hence the length.
#pragma once

#include <initializer_list>
#include <tuple>
#include <type_traits>
#include <utility>

#include "mechanics/drive_input.hpp"
#include "numerics/finite.hpp"
#include "parts/frictions/rotor_friction.hpp"
#include "parts/mode.hpp"
#include "parts/motors/no_motor.hpp"
#include "parts/place.hpp"

namespace arm {

template <class Motor, class Gear, class LinkFriction, class Rotor, class... Extras>
struct Drive {
  Motor motor;
  Gear gear;
  LinkFriction friction;
  Rotor rotor;
  std::tuple<Extras...> extras = {};

  constexpr bool operator==(const Drive&) const = default;

  static constexpr bool driven = Motor::present;
  static constexpr bool elastic = driven && !Gear::rigid;
  static constexpr bool carries_rotor = driven && Gear::rigid;
  // Indices of the states: those of the motor, then tm and wm, further ones of the gear, then those
  // of the extras.
  static constexpr int tm = Motor::states, wm = Motor::states + 1;
  static constexpr int own = Motor::states + (elastic ? Gear::states : 0);
  static constexpr int states = own + (0 + ... + Extras::states);
  // Indices of the parts that have modes: motor, gear, rotor, extras.
  static constexpr int of_gear = Motor::modes, of_rotor = of_gear + (elastic ? Gear::modes : 0);
  static constexpr int of_extras = of_rotor + (elastic ? Rotor::modes : 0);
  static constexpr int modes = of_extras + (0 + ... + Extras::modes);
  static constexpr int gear_modes = Gear::modes, rotor_modes = Rotor::modes;
  // Parts that are held while the gear carries a load.
  static constexpr unsigned active_under_load = elastic && Gear::modes > 0 ? 1u << of_gear : 0u;

  template <class X>
  using Input = DriveInput<states, modes, X>;
  using Modes = DriveModes<modes>;

  // Inertia of a rotor that turns with its link, at the link [kg m2].
  constexpr Real carried() const { return carries_rotor ? motor.Mm / (gear.Ng * gear.Ng) : 0.0; }

  // D, with these parts held.
  constexpr DriveRates<states, Real> D(unsigned active) const {
    DriveRates<states, Real> D;
    if constexpr (driven)
      for (int k = 0; k < Motor::states; ++k) D.f[k] = motor.inertia(k, is_motor_active(active));
    if constexpr (elastic) {
      D.f[tm] = 1.0, D.f[wm] = motor.Mm;
      if constexpr (Rotor::modes > 0)
        if (is_active(active, of_rotor)) D.f[wm] = 0.0;
    }
    for (int k = elastic ? wm + 1 : own; k < states; ++k) D.f[k] = 1.0;
    return D;
  }

  // The drive of the linear parts, which is this one where all parts are linear.
  template <class Part>
  using LinearOf = std::remove_cvref_t<decltype(std::declval<Part>().linear())>;
  using Linear = Drive<LinearOf<Motor>, LinearOf<Gear>, LinearOf<LinkFriction>, LinearOf<Rotor>,
                       LinearOf<Extras>...>;
  static constexpr bool is_linear = std::is_same_v<Linear, Drive>;
  constexpr Linear linear() const {
    static_assert(Linear::states == states && Linear::modes == modes);
    return {motor.linear(), gear.linear(), friction.linear(), rotor.linear(),
            std::apply([](const auto&... extra) { return std::make_tuple(extra.linear()...); },
                       extras)};
  }

  // f and g, eq. (1), (2) and the drive's part of (4), without the friction of coulomb.hpp.
  template <class X>
  ARM_INLINE constexpr DriveRates<states, X> rates(const Input<X>& x, unsigned active) const {
    DriveRates<states, X> r;
    const FrictionFactors<X> factors = friction_factors_at(x);
    r.g = -viscous_torque(friction, x.v, factors);
    X shaft{};  // torque on the rotor, without its friction and the gear
    if constexpr (driven) {
      motor.rates(x.z, x.u, motor_angle(x), voltage_speed(x), x.offset[0], is_motor_active(active),
                  r.f);
      shaft = motor.torque(x.z, motor_angle(x));
    }
    for_each_extra(
        [&]<class Extra>(const Extra& extra, auto state, auto mode) __attribute__((always_inline)) {
          const X torque = torque_of<state, mode>(extra, x, active);
          if constexpr (Extra::states > 0)
            extra.rates(angle_of(extra, x), speed_of(extra, x), x.z + state, r.f + state);
          if constexpr (Extra::place == Place::rotor)
            shaft += torque;
          else
            r.g += torque;
        });
    if constexpr (elastic) {
      const X T = gear_torque_on_link(x, active);
      r.f[tm] = x.z[wm];
      if constexpr (Rotor::modes > 0)
        r.f[wm] = is_active(active, of_rotor)
                      ? -x.z[wm]
                      : shaft - torque_on_rotor(x, T) -
                            rotor.resisting_torque(x.z[wm], torque_on_rotor(x, T), shaft,
                                                   x.offset[of_rotor], factors);
      else
        r.f[wm] = shaft - torque_on_rotor(x, T);
      r.g += T;
    } else if constexpr (driven) {
      if constexpr (Rotor::modes > 0) shaft -= viscous_torque(rotor.law, motor_speed(x), factors);
      r.g += shaft / gear.Ng;
    }
    if constexpr (depends_on_temperature) add_heat(x, active, factors, r.f);
    return r;
  }

  // Whether friction heats an extra that changes it (gear_temperature.hpp), and the factors of
  // that.
  static constexpr int heated_extra = [] {
    int e = 0, at = -1;
    ((at = ChangesFriction<Extras> ? e : at, ++e), ...);
    return at;
  }();
  static constexpr bool depends_on_temperature = heated_extra >= 0;
  static constexpr int temperature_state() {
    return index_after(heated_extra, own, {Extras::states...});
  }
  template <class X>
  ARM_INLINE constexpr FrictionFactors<X> friction_factors_at(const Input<X>& x) const {
    if constexpr (depends_on_temperature)
      return std::get<heated_extra>(extras).compute_factors(x.z[temperature_state()]);
    else
      return {};
  }
  // Power of the friction of link and rotor [W].
  template <class X>
  ARM_INLINE constexpr X friction_power(const Input<X>& x, unsigned active,
                                        const FrictionFactors<X>& factors) const {
    const X T = transmitted_torque(x, active);
    X P = viscous_torque(friction, x.v, factors) * x.v +
          sliding_under(x, T, sign_of(x.v)) * magnitude(x.v);
    if constexpr (elastic && Rotor::modes > 0)
      P += rotor.dissipated_power(x.z[wm], torque_on_rotor(x, T), drive_torque(x, active),
                                  x.offset[of_rotor], factors);
    if constexpr (carries_rotor && Rotor::modes > 0)
      P += viscous_torque(rotor.law, motor_speed(x), factors) * motor_speed(x);
    return P;
  }
  // The temperature of the gear [degC].
  constexpr Real gear_temperature(const Input<Real>& x) const {
    if constexpr (depends_on_temperature)
      return std::get<heated_extra>(extras).ambient + x.z[temperature_state()];
    return no_number();
  }

  static constexpr int extra_count = sizeof...(Extras);

  // Whether the gear's torque beyond that of the linear one is all of `nonlinear_part`.
  static constexpr bool is_only_gear_nonlinear =
      std::is_same_v<Linear, Drive<Motor, LinearOf<Gear>, LinkFriction, Rotor, Extras...>> &&
      elastic && requires(const Gear& part, Real x) { part.beyond_linear(x, x); };
  // Whether row k of `nonlinear_part` may differ from 0; g is row `states`.
  static constexpr bool is_nonlinear(int k) {
    if (driven && k < Motor::states) return !std::is_same_v<LinearOf<Motor>, Motor>;
    return !is_linear && !(elastic && k == tm);
  }
  // Difference between `rates` and those of the linear drive, which may be known.
  template <class X>
  ARM_INLINE constexpr DriveRates<states, X> nonlinear_part(const Input<X>& x, unsigned active,
                                                            const Linear& linear) const {
    DriveRates<states, X> all = rates(x, active);
    const DriveRates<states, X> of_linear = linear.rates(x, active);
    for (int k = 0; k < states; ++k) all.f[k] -= of_linear.f[k];
    all.g -= of_linear.g;
    return all;
  }
  template <class X>
  ARM_INLINE constexpr DriveRates<states, X> nonlinear_part(const Input<X>& x,
                                                            unsigned active) const {
    if constexpr (is_only_gear_nonlinear && !kDifferentiates)
      if (active == 0) {
        DriveRates<states, X> of_gear = {};
        of_gear.g = gear.beyond_linear(x.z[tm], x.q);
        of_gear.f[wm] = -torque_on_rotor(x, of_gear.g);
        return of_gear;
      }
    return nonlinear_part(x, active, linear());
  }

  // Dry friction at the link, with that of a rotor that turns with it. Load friction follows the
  // load in the given modes.
  static constexpr bool friction_varies = LinkFriction::varies || (carries_rotor && Rotor::varies);
  static constexpr bool holds_by_load = LinkFriction::loaded || (carries_rotor && Rotor::loaded);
  // Whether it is another one in the other direction.
  static constexpr bool friction_is_directed =
      LinkFriction::directed || (carries_rotor && Rotor::directed);
  // Whether a nonlinear part depends on the motor's states.
  static constexpr bool is_motor_nonlinear =
      driven && (!std::is_same_v<LinearOf<Motor>, Motor> || (!elastic && holds_by_load) ||
                 (elastic && Rotor::directed));
  constexpr bool is_dry() const {
    if constexpr (carries_rotor && Rotor::modes > 0)
      if (rotor.law.is_dry()) return true;
    return friction.is_dry();
  }
  // Torque against the link, which slides that `way`: 1 or -1.
  template <class X>
  ARM_INLINE constexpr X sliding_torque(const Input<X>& x, unsigned active, X way) const {
    return sliding_under(x, transmitted_torque(x, active), way);
  }
  // Sliding torque under the torque T of the gear on its link.
  template <class X>
  ARM_INLINE constexpr X sliding_under(const Input<X>& x, X T, X way) const {
    X dry = friction.sliding_torque(x.v, make_link_torques<LinkFriction>(x, T, way));
    if constexpr (carries_rotor && Rotor::modes > 0)
      dry += rotor.law.sliding_torque(
                 motor_speed(x), make_link_torques<Rotor>(x, gear.Ng * T, rotor_direction(way))) /
             magnitude(gear.Ng);
    return dry;
  }
  template <class X>
  ARM_INLINE constexpr X holding_torque(const Input<X>& x, unsigned active, X way) const {
    const X T = transmitted_torque(x, active);
    X dry = friction.holding_torque(make_link_torques<LinkFriction>(x, T, way));
    if constexpr (carries_rotor && Rotor::modes > 0)
      dry +=
          rotor.law.holding_torque(make_link_torques<Rotor>(x, gear.Ng * T, rotor_direction(way))) /
          magnitude(gear.Ng);
    return dry;
  }

  // Put the current [A], the angle [rad] and the speed [rad/s] of the motor into x.
  constexpr void set_motor(Input<Real>& x, Real current, Real angle, Real speed) const {
    if constexpr (driven) motor.set_current(x.z, current);
    if constexpr (elastic) x.z[tm] = angle, x.z[wm] = speed;
  }
  // The states behind a link at (q, v): no current, gear unloaded.
  constexpr Input<Real> make_rest_state(Real q, Real v) const {
    Input<Real> x = {};
    x.q = q, x.v = v;
    set_motor(x, 0.0, q / gear.Ng, v / gear.Ng);
    if constexpr (elastic && requires { gear.set_unloaded(q, v, x.z[0], x.z[0]); })
      gear.set_unloaded(q, v, x.z[tm], x.z[wm]);
    return x;
  }

  template <class X>
  ARM_INLINE constexpr X current(const Input<X>& x) const {
    if constexpr (driven) return motor.current(x.z);
    return X{};
  }
  template <class X>
  ARM_INLINE constexpr X motor_angle(const Input<X>& x) const {
    if constexpr (elastic) return x.z[tm];
    return x.q / gear.Ng;
  }
  template <class X>
  ARM_INLINE constexpr X motor_speed(const Input<X>& x) const {
    if constexpr (elastic) return x.z[wm];
    return x.v / gear.Ng;
  }
  // Torque of the gear on its link, which accelerates at `a` [N m].
  constexpr Real gear_torque(const Input<Real>& x, Real a) const {
    const Modes now = modes_at(x);
    return transmitted_torque(apply_modes(x, now), now.active()) - carried() * a;
  }

  // Whether extras have potential energy, and whether supplied power grows with the speed.
  static constexpr bool has_potential = (false || ... || HasPotential<Extras>);
  static constexpr bool supply_grows_with_speed = requires { Motor::supply_grows_with_speed; };

  // Whether the supply alone bounds commands, as voltages; and the command of x in its bounds.
  static constexpr bool bounded_by_supply = Motor::takes == Command::voltage;
  template <class X>
  ARM_INLINE constexpr X bound_command(const Input<X>& x, Real supply) const {
    if constexpr (bounded_by_supply)
      return clamp(x.u, supply);
    else
      return clamp(x.u, motor.largest_command(x.z, supply));
  }

  // Set a further input of the motor in x, by its number, and return the applied value.
  constexpr void set_further_input(int input, Input<Real>& x, Real value, Real supply) const {
    if constexpr (requires { Motor::further; }) motor.set_further_input(input, x.z, value, supply);
  }
  constexpr Real applied_inputs(int input, const Input<Real>& x) const {
    if constexpr (requires { Motor::further; }) return motor.applied_inputs(input, x.z);
    return 0.0;
  }

  // The current along the rotor's flux [A], of motors that have one.
  static constexpr bool has_current_d =
      requires(const Motor& motor, const Real* z) { motor.current_d(z); };
  constexpr Real current_d(const Input<Real>& x) const {
    if constexpr (has_current_d) return motor.current_d(x.z);
    return 0.0;
  }

  // The temperature of the winding [degC], and whether it is beyond its limit (winding.hpp).
  static constexpr bool has_winding_temperature =
      requires(Motor motor, const Real* z) { motor.temperature(z); };
  constexpr Real winding_temperature(const Input<Real>& x) const {
    if constexpr (has_winding_temperature) return motor.temperature(x.z);
    return no_number();
  }
  constexpr bool is_overheated(const Input<Real>& x) const {
    if constexpr (has_winding_temperature) return motor.is_overheated(x.z);
    return false;
  }

  // Whether x, as start and end of a step, surely calls for the regular modes of all parts. If
  // false, the modes must be determined.
  template <class X>
  ARM_INLINE constexpr Mask<X> is_regular(const Input<X>& x) const {
    return where(is_ever_regular(), is_regular_if_ever(x));
  }
  // Whether a drive that may be regular surely is at x.
  template <class X>
  ARM_INLINE constexpr Mask<X> is_regular_if_ever(const Input<X>& x) const {
    Mask<X> regular = X{} == X{};
    if constexpr (may_be_regular && driven && Motor::modes > 0)
      regular &= motor.is_regular(x.z, x.u, voltage_speed(x));
    for_each_extra(
        [&]<class Extra>(const Extra& extra, auto state, auto) __attribute__((always_inline)) {
          if constexpr (may_be_regular && Extra::modes > 0)
            regular &= extra.is_regular(angle_of(extra, x), speed_of(extra, x), x.z + state);
        });
    return regular;
  }
  // Whether such an x exists.
  constexpr bool is_ever_regular() const {
    if constexpr (elastic && Rotor::modes > 0) return may_be_regular && rotor.is_regular();
    return may_be_regular;
  }
  // The modes that x calls for.
  constexpr Modes modes_at(const Input<Real>& x) const {
    Modes at;
    if constexpr (driven && Motor::modes > 0) at.at[0] = motor.mode_at(x.z, x.u, voltage_speed(x));
    set_modes_of_state(x, at);
    if constexpr (elastic && Rotor::modes > 0)
      at.at[of_rotor] = rotor.mode_at(x.z[wm], rotor_torques(x, at));
    return at;
  }
  // The modes for which x calls at the end of a step in `now` from `start`: `now` if they hold.
  constexpr Modes required_mode(const Input<Real>& start, const Input<Real>& x,
                                const Modes& now) const {
    Modes at = now;
    if constexpr (driven && Motor::modes > 0)
      at.at[0] = motor.required_mode(x.z, x.u, voltage_speed(x), now.at[0]);
    set_modes_of_state(x, at);
    if constexpr (elastic && Rotor::modes > 0)
      at.at[of_rotor] =
          rotor.required_mode(start.z[wm], x.z[wm], rotor_torques(x, now), now.at[of_rotor]);
    return at;
  }
  // Distance of x from the next change of mode, negative if a mode no longer holds. (The least of
  // quantities with different units; only its sign counts.)
  constexpr Real margin(const Input<Real>& x, const Modes& now) const {
    Real smallest = 1.0;
    const auto lower_to = [&smallest](Real margin) {
      smallest = margin < smallest ? margin : smallest;
    };
    if constexpr (driven && Motor::modes > 0)
      lower_to(motor.margin(x.z, x.u, voltage_speed(x), now.at[0]));
    if constexpr (elastic && Gear::modes > 0)
      lower_to(gear.margin(x.z[tm], x.z[wm], x.q, x.v, now.at[of_gear]));
    for_each_extra([&]<class Extra>(const Extra& extra, auto state, auto mode) {
      if constexpr (Extra::modes > 0)
        lower_to(extra.margin(angle_of(extra, x), speed_of(extra, x), x.z + state, now.at[mode]));
    });
    if constexpr (elastic && Rotor::modes > 0)
      lower_to(rotor.margin(x.z[wm], rotor_torques(x, now), now.at[of_rotor]));
    return smallest;
  }
  // Set x to the values that its modes hold, against rounding.
  constexpr void enforce_modes(Input<Real>& x, const Modes& now) const {
    if constexpr (driven && Motor::modes > 0) motor.enforce_modes(x.z, now.at[0]);
    if constexpr (elastic && Rotor::modes > 0) rotor.enforce_modes(x.z[wm], now.at[of_rotor]);
  }
  // Whether the motor has an algebraic state; it is set to its value.
  constexpr bool has_algebraic_state() const {
    if constexpr (driven) return motor.inertia(0, false) == 0.0;
    return false;
  }
  static constexpr bool can_have_algebraic_state = driven && !requires { Motor::never_algebraic; };
  constexpr void set_algebraic_state(Input<Real>& x) const {
    if constexpr (driven) motor.set_algebraic_state(x.z, x.u, voltage_speed(x));
  }

  // Whether the gear has states of its own, which follow the twist at the start of each step.
  static constexpr bool has_gear_memory = elastic && requires { Gear::remembers; };
  constexpr void update_gear_memory(Input<Real>& x) const {
    if constexpr (has_gear_memory) gear.update_memory(x.z[tm], x.q, x.z + wm + 1);
  }

  // x with the numbers of these modes.
  constexpr Input<Real> apply_modes(Input<Real> x, const Modes& now) const {
    for (int m = 0; m < modes; ++m) x.offset[m] = now.at[m].offset;
    return x;
  }

  // Speed in the induced voltage: the rotor's, times the factor of torque ripple.
  template <class X>
  ARM_INLINE constexpr X voltage_speed(const Input<X>& x) const {
    if constexpr (requires { motor.ripple(x.q); })
      return motor.ripple(motor_angle(x)) * motor_speed(x);
    return motor_speed(x);
  }
  static constexpr bool is_motor_active(unsigned on) {
    return Motor::modes > 0 && is_active(on, 0);
  }
  template <class X>
  ARM_INLINE constexpr X gear_torque_on_link(const Input<X>& x, unsigned active) const {
    const X offset = x.offset[Gear::modes > 0 ? of_gear : 0];
    const bool in_mode = is_active(active, of_gear) && Gear::modes > 0;
    if constexpr (has_gear_memory)
      return gear.torque(x.z[tm], x.z[wm], x.q, x.v, offset, in_mode, x.z + wm + 1);
    else
      return gear.torque(x.z[tm], x.z[wm], x.q, x.v, offset, in_mode);
  }
  // Torque on the rotor from the torque T of an elastic gear on its link.
  template <class X>
  ARM_INLINE constexpr X torque_on_rotor(const Input<X>& x, X T) const {
    if constexpr (requires { gear.torque_on_rotor(x.z[0], x.q, T); })
      return gear.torque_on_rotor(x.z[tm], x.q, T);
    return gear.Ng * T;
  }
  // Torque of the gear on its link; for a rigid gear, the motor's torque.
  template <class X>
  ARM_INLINE constexpr X transmitted_torque(const Input<X>& x, unsigned active) const {
    if constexpr (elastic)
      return gear_torque_on_link(x, active);
    else if constexpr (driven)
      return motor.torque(x.z, motor_angle(x)) / gear.Ng;
    return X{};
  }

  // Torque of the motor and of extras on the rotor.
  template <class X>
  ARM_INLINE constexpr X drive_torque(const Input<X>& x, unsigned active) const {
    X torque = motor.torque(x.z, motor_angle(x));
    for_each_extra([&]<class Extra>(const Extra& extra, auto state, auto mode)
                       __attribute__((always_inline)) {
                         if constexpr (Extra::place == Place::rotor)
                           torque += torque_of<state, mode>(extra, x, active);
                       });
    return torque;
  }

  template <class Extra, class X>
  ARM_INLINE constexpr X angle_of(const Extra&, const Input<X>& x) const {
    if constexpr (Extra::place == Place::rotor) return motor_angle(x);
    return x.q;
  }
  template <class Extra, class X>
  ARM_INLINE constexpr X speed_of(const Extra&, const Input<X>& x) const {
    if constexpr (Extra::place == Place::rotor) return motor_speed(x);
    return x.v;
  }
  template <int state, int mode, class X>
  ARM_INLINE constexpr X torque_of(const auto& extra, const Input<X>& x, unsigned active) const {
    return extra.torque(angle_of(extra, x), speed_of(extra, x), x.z + state,
                        x.offset[extra.modes > 0 ? mode : 0],
                        extra.modes > 0 && is_active(active, mode));
  }

  // body(extra, index of its first state, index of its mode) for all extras.
  template <class Body>
  ARM_INLINE constexpr void for_each_extra(Body&& body) const {
    [&]<int... e>(std::integer_sequence<int, e...>) __attribute__((always_inline)) {
      (body(std::get<e>(extras),
            std::integral_constant<int, index_after(e, own, {Extras::states...})>{},
            std::integral_constant<int, index_after(e, of_extras, {Extras::modes...})>{}),
       ...);
    }(std::make_integer_sequence<int, extra_count>{});
  }

 private:
  // The modes of gear and extras, which go with the state alone.
  constexpr void set_modes_of_state(const Input<Real>& x, Modes& at) const {
    if constexpr (elastic && Gear::modes > 0)
      at.at[of_gear] = gear.mode_at(x.z[tm], x.z[wm], x.q, x.v);
    for_each_extra([&]<class Extra>(const Extra& extra, auto state, auto mode) {
      if constexpr (Extra::modes > 0)
        at.at[mode] = extra.mode_at(angle_of(extra, x), speed_of(extra, x), x.z + state);
    });
  }

  static constexpr bool may_be_regular =
      (!driven || Motor::modes == 0 ||
       requires(const Motor& part, const Real* z, Real x) { part.is_regular(z, x, x); }) &&
      (!elastic || Gear::modes == 0) &&
      (true && ... && (Extras::modes == 0 || requires(const Extras& part, const Real* z, Real x) {
         part.is_regular(x, x, z);
       }));

  constexpr RotorTorques rotor_torques(const Input<Real>& at, const Modes& now) const {
    const Input<Real> x = apply_modes(at, now);
    const unsigned active = now.active();
    RotorTorques on = {drive_torque(x, active), torque_on_rotor(x, gear_torque_on_link(x, active)),
                       kRounding * magnitude(gear.Ng * gear.Kg * x.q), friction_factors_at(x)};
    on.torque -= on.of_gear;
    return on;
  }

  // The direction of the rotor behind a rigid gear, where the link moves that `way`.
  template <class X>
  ARM_INLINE constexpr X rotor_direction(X way) const {
    return gear.Ng < 0.0 ? -way : way;
  }
  // Torques for the friction of a link, and of a rotor that turns with it.
  template <class Law, class X>
  ARM_INLINE constexpr ShaftTorques<X> make_link_torques(const Input<X>& x, X T, X way) const {
    if constexpr (!Law::directed) return {T, T, X{}, friction_factors_at(x)};
    return {way * T, way * T, way * T, friction_factors_at(x)};
  }

  // Adds the heat of friction and of the winding to the rates of temperatures.
  template <class X>
  ARM_INLINE constexpr void add_heat(const Input<X>& x, unsigned active,
                                     const FrictionFactors<X>& factors, X* f) const {
    const auto& gear_body = std::get<heated_extra>(extras);
    X P = friction_power(x, active, factors);
    if constexpr (has_winding_temperature) {
      const X flow = gear_body.power_from_winding(motor.winding.ambient + x.z[Motor::rise],
                                                  x.z[temperature_state()]);
      P += flow;
      f[Motor::rise] -= flow;
    }
    f[temperature_state()] += gear_body.temperature_rate(P);
  }

  // `first` and the counts of so many extras.
  static constexpr int index_after(int extras, int first, std::initializer_list<int> counts) {
    for (const int count : counts)
      if (extras-- > 0) first += count;
    return first;
  }
};

}  // namespace arm
