// A motor whose drive closes a current loop: its command u is a current [A]. The controller is a PI
// controller in continuous time with feed-forward of the induced voltage,
//
//   V* = P (u - i) + x + E wm          dx/dt = I (u - i)
//
// and the voltage V of the winding is V* within the supply U. Beyond it, against wind-up,
//
//   dx/dt = I (u - i) + I/P (V - V*) = I/P (V - x - E wm)
//
// The mode (mode.hpp) is `active` there, and its number is V. Both modes give the same rates where
// V* = V: nothing jumps.
//
// With a bandwidth f, P = 2 pi f L and I = 2 pi f R: the zero of the PI cancels the winding's pole,
// and within the supply 1 / (2 pi f) di/dt = u - i.
#pragma once

#include "numerics/number.hpp"
#include "parts/command.hpp"
#include "parts/mode.hpp"

namespace arm {

// As the scene states it: a bandwidth, or gains.
struct CurrentControl {
  constexpr bool operator==(const CurrentControl&) const = default;

  Real bandwidth = 0.0;    // Hz; 0: gains are given
  Real P = 0.0, I = 0.0;   // V/A, V/(A s)
  Real feedforward = 1.0;  // share of the induced voltage

  // With the gains for this winding, which follow from a bandwidth once and not in every step.
  constexpr CurrentControl tune_gains(Real R, Real L) const {
    CurrentControl control = *this;
    if (!(bandwidth > 0.0)) return control;
    const Real rate = 1.0 / time_constant(bandwidth);
    control.P = rate * L, control.I = rate * R;
    return control;
  }
};

// R, L and Kb may vary with faults and heat; the gains follow from the data sheet.
struct DataSheet {
  constexpr bool operator==(const DataSheet&) const = default;

  Real R, L, Kb;  // ohm, H, V s/rad
  Real supply;    // V
};

template <class Motor>
struct CurrentLoop : Motor {
  // g++ 11 leaves the base out of a defaulted comparison.
  constexpr bool operator==(const CurrentLoop& other) const {
    return Motor::operator==(other) && control == other.control && nominal == other.nominal;
  }

  CurrentControl control;  // tuned
  DataSheet nominal;

  constexpr CurrentLoop(const Motor& motor, const CurrentControl& stated, const DataSheet& sheet)
      : Motor(motor), control(stated.tune_gains(sheet.R, sheet.L)), nominal(sheet) {}

  static constexpr int states = 2;  // i [A], x [V]
  static constexpr int modes = 1;
  static constexpr Command takes = Command::current;

  constexpr const CurrentLoop& linear() const { return *this; }

  template <class X>
  ARM_INLINE constexpr X largest_command(const X*, Real) const {
    return X{} + limit_or_none(this->current_limit);
  }

  constexpr Real inertia(int k, bool) const { return k == 0 ? this->L : 1.0; }
  constexpr bool obeys_circuit(bool) const { return true; }
  template <class X>
  ARM_INLINE constexpr void rates(const X* z, X u, X, X wm, X offset, bool active, X* f) const {
    const X V = active ? offset : request_voltage(z, u, wm);
    f[0] = V - this->R_circuit() * z[0] - this->Kb * wm;
    f[1] = active ? control.I / control.P * (V - z[1] - E() * wm) : control.I * (u - z[0]);
  }
  // The integral is set to hold a current that is set by hand.
  constexpr void set_current(Real* z, Real current) const {
    z[0] = current, z[1] = this->R_circuit() * current;
  }
  static constexpr bool never_algebraic = true;
  constexpr void set_algebraic_state(Real*, Real, Real) const {}

  template <class X>
  ARM_INLINE constexpr Mask<X> is_regular(const X* z, X u, X wm) const {
    return magnitude(request_voltage(z, u, wm)) < nominal.supply;
  }
  constexpr Mode mode_at(const Real* z, Real u, Real wm) const {
    const Real V = request_voltage(z, u, wm);
    if (magnitude(V) <= nominal.supply) return {};
    return {true, V < 0.0 ? -nominal.supply : nominal.supply};
  }
  constexpr Mode required_mode(const Real* z, Real u, Real wm, const Mode& mode) const {
    if (margin(z, u, wm, mode) >= 0.0) return mode;
    return mode.active ? Mode{} : mode_at(z, u, wm);
  }
  constexpr Real margin(const Real* z, Real u, Real wm, const Mode& mode) const {
    const Real V = request_voltage(z, u, wm), rounding = kRounding * nominal.supply;
    if (!mode.active) return nominal.supply - magnitude(V) + rounding;
    return (mode.offset < 0.0 ? -V : V) - nominal.supply + rounding;
  }
  constexpr void enforce_modes(Real*, const Mode&) const {}

  template <class X>
  ARM_INLINE constexpr X supplied_power(const X* z, X u, X, X wm, bool active) const {
    const X V =
        active ? clamp(request_voltage(z, u, wm), nominal.supply) : request_voltage(z, u, wm);
    return V * z[0] + (this->Kt - this->Kb) * wm * z[0];
  }
  template <class X>
  ARM_INLINE constexpr X supply_limit(const X* z, X, X wm) const {
    return Motor::supply_limit(z, X{} + nominal.supply, wm);
  }

 private:
  constexpr Real E() const { return control.feedforward * nominal.Kb; }
  template <class X>
  ARM_INLINE constexpr X request_voltage(const X* z, X u, X wm) const {
    return control.P * (u - z[0]) + z[1] + E() * wm;
  }
};

}  // namespace arm
