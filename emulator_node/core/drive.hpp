// The drive of one joint: all that stands between its command u and the torque T on its link,
// stated once. With local states z, the link's q and v:
//
//   D dz/dt = f(z, q, v, u)      torque on the link  g(z, q, v) - carried dv/dt
//
// D may have zeros: no inductance, a current at its limit. Whatever a scheme, an energy balance or
// a report needs of a drive comes from here (drive_table.hpp, energy.hpp).
//
// Each part names a part that is linear, by `linear()`: itself if it is, else the one that stands
// in its place in the matrix A of the schemes. What the two differ by is the drive's rest, which
// enters each stage (linearly_implicit.hpp).
#pragma once

#include <type_traits>
#include <utility>

#include "dc_motor.hpp"
#include "gear.hpp"
#include "link_friction.hpp"
#include "progressive_gear.hpp"

namespace arm {

// What a drive is asked at. `side`: see DcMotor.
template <int n, class X>
struct DriveInput {
  X z[n > 0 ? n : 1] = {};
  X q{}, v{}, u{}, side{};
};

template <int n, class X>
struct DriveRates {
  X f[n > 0 ? n : 1] = {};
  X g{};
};

template <class Motor, class Gear>
struct Drive {
  Motor motor;
  Gear gear;
  LinkFriction friction;

  static constexpr bool driven = Motor::present;
  static constexpr bool elastic = driven && !Gear::rigid;
  static constexpr bool carries_rotor = driven && Gear::rigid;
  // Where the states stand: those of the motor, then tm and wm.
  static constexpr int i = 0;
  static constexpr int tm = Motor::states, wm = Motor::states + 1;
  static constexpr int states = Motor::states + (elastic ? Gear::states : 0);

  template <class X>
  using Input = DriveInput<states, X>;

  // Inertia of a rotor that turns with its link, as the link feels it [kg m2].
  constexpr double carried() const { return carries_rotor ? motor.Mm / (gear.Ng * gear.Ng) : 0.0; }

  constexpr DriveRates<states, double> D(bool limited) const {
    DriveRates<states, double> D;
    if constexpr (driven) D.f[i] = motor.inertia_of_current(limited);
    if constexpr (elastic) D.f[tm] = 1.0, D.f[wm] = motor.Mm;
    return D;
  }

  // The drive of the linear parts, which is this one where all parts are linear.
  template <class Part>
  using LinearOf = std::remove_cvref_t<decltype(std::declval<Part>().linear())>;
  using Linear = Drive<LinearOf<Motor>, LinearOf<Gear>>;
  static constexpr bool is_linear =
      std::is_same_v<LinearOf<Motor>, Motor> && std::is_same_v<LinearOf<Gear>, Gear>;
  constexpr Linear linear() const { return {motor.linear(), gear.linear(), friction}; }

  // f and g, eq. (1), (2) and the drive's part of (4).
  template <class X>
  ARM_INLINE constexpr DriveRates<states, X> rates(const Input<X>& x, bool limited) const {
    DriveRates<states, X> r;
    r.g = -friction.Dl * x.v;
    if constexpr (driven) {
      r.f[i] = motor.circuit(x.z[i], x.u, motor_speed(x), x.side, limited);
      const X shaft = motor.torque(x.z[i]);
      if constexpr (elastic) {
        const X T = gear.torque(x.z[tm], x.z[wm], x.q, x.v);
        r.f[tm] = x.z[wm];
        r.f[wm] = shaft - gear.Ng * T;
        r.g += T;
      } else {
        r.g += shaft / gear.Ng;
      }
    }
    return r;
  }

  // What `rates` has beyond those of the linear drive.
  template <class X>
  ARM_INLINE constexpr DriveRates<states, X> rest(const Input<X>& x, bool limited) const {
    DriveRates<states, X> all = rates(x, limited);
    const DriveRates<states, X> of_linear = linear().rates(x, limited);
    for (int k = 0; k < states; ++k) all.f[k] -= of_linear.f[k];
    all.g -= of_linear.g;
    return all;
  }

  // The states of a motor with a current [A], an angle [rad] and a speed [rad/s].
  constexpr Input<double> with_motor(double current, double angle, double speed, double q,
                                     double v) const {
    Input<double> x = {{}, q, v, 0.0, 0.0};
    if constexpr (driven) x.z[i] = current;
    if constexpr (elastic) x.z[tm] = angle, x.z[wm] = speed;
    return x;
  }
  // The states behind a link at (q, v): no current, gear unloaded.
  constexpr Input<double> at_rest_behind(double q, double v) const {
    return with_motor(0.0, q / gear.Ng, v / gear.Ng, q, v);
  }

  template <class X>
  ARM_INLINE constexpr X current(const Input<X>& x) const {
    if constexpr (driven) return x.z[i];
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
  template <class X>
  ARM_INLINE constexpr X gear_torque(const Input<X>& x, X a) const {
    return rates(x, false).g + friction.Dl * x.v - carried() * a;
  }

  // Energy in windings, rotor and gear; and power that friction, windings and the gear's damping
  // take, that the supply gives, and that it can give at most. `limited`: see DcMotor.
  template <class X>
  ARM_INLINE constexpr X stored(const Input<X>& x) const {
    X E = 0.5 * carried() * x.v * x.v;
    if constexpr (driven) E += motor.stored(x.z[i]);
    if constexpr (elastic) E += 0.5 * motor.Mm * x.z[wm] * x.z[wm] + gear.stored(x.z[tm], x.q);
    return E;
  }
  template <class X>
  ARM_INLINE constexpr X dissipated(const Input<X>& x) const {
    X P = friction.Dl * x.v * x.v + friction.Dc * magnitude(x.v);
    if constexpr (driven) P += motor.dissipated(x.z[i]);
    if constexpr (elastic) P += gear.dissipated(x.z[wm], x.v);
    return P;
  }
  template <class X>
  ARM_INLINE constexpr X given(const Input<X>& x, bool limited) const {
    if constexpr (driven) return motor.given(x.z[i], x.u, motor_speed(x), limited);
    return X{};
  }
  template <class X>
  ARM_INLINE constexpr X given_at_most(const Input<X>& x) const {
    if constexpr (driven) return motor.given_at_most(x.u, motor_speed(x));
    return X{};
  }
};

}  // namespace arm
