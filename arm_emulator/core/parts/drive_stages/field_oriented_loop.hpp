// A synchronous motor whose drive closes current loops in the frame of the rotor: its command u is
// the current across the flux [A], and a further one, ud, that along it. Each axis has a PI
// controller in continuous time with feed-forward of the induced voltage,
//
//   V*q = Pq (u - iq) + xq + F p wm (Ld id + psi)     dxq/dt = I (u - iq)      Pq = Lq / Ld Pd
//   V*d = Pd (ud - id) + xd - F p wm Lq iq            dxd/dt = I (ud - id)
//
// The inverter reaches the amplitude U. V*d has priority up to 0.95 U, as drives limit it to keep
// some voltage across the flux. V*q has the rest of the circle; beyond, each x is drawn to where
// V* = V, as in current_loop.hpp. Rates are continuous at the circle, and their slope is bounded:
// that of the rest is 3 at 0.95 U and infinite at U. So stages evaluate it (a part without modes),
// and order 2 holds.
//
// With a bandwidth f, P = 2 pi f L and I = 2 pi f R: within the circle both axes are of first order
// at any speed, 1 / (2 pi f) di/dt = u - i.
#pragma once

#include "numerics/number.hpp"
#include "parts/command.hpp"
#include "parts/drive_stages/current_loop.hpp"
#include "parts/motors/pmsm.hpp"

namespace arm {

// Numbers of the data sheet, which set up the drive; those of the motor may vary with faults and
// heat.
struct SynchronousDataSheet {
  constexpr bool operator==(const SynchronousDataSheet&) const = default;

  Real R, Ld, Lq, psi, p;
  Real amplitude;  // V
};

// `whole` false: without limits and products, which is linear.
template <class Motor, bool whole = true>
struct FieldOrientedLoop : Motor {
  // g++ 11 leaves the base out of a defaulted comparison.
  constexpr bool operator==(const FieldOrientedLoop& other) const {
    return Motor::operator==(other) && control == other.control && nominal == other.nominal;
  }

  CurrentControl control;  // tuned
  SynchronousDataSheet nominal;
  Real Pd, Pq;  // V/A

  constexpr FieldOrientedLoop(const Motor& motor, const CurrentControl& stated,
                              const SynchronousDataSheet& sheet)
      : Motor(motor),
        control(stated.tune_gains(sheet.R, sheet.Lq)),
        nominal(sheet),
        Pd(P(sheet.Ld)),
        Pq(P(sheet.Lq)) {}
  // Around another motor.
  template <class Other, bool limits>
  constexpr FieldOrientedLoop(const Motor& motor, const FieldOrientedLoop<Other, limits>& other)
      : Motor(motor), control(other.control), nominal(other.nominal), Pd(other.Pd), Pq(other.Pq) {}

  static constexpr int states = 5;  // id, iq [A], ud [A], which rests, xd, xq [V]
  static constexpr Command takes = Command::current;

  constexpr auto linear() const {
    auto motor = Motor::linear();
    return FieldOrientedLoop<decltype(motor), false>(motor, *this);
  }

  constexpr Real inertia(int k, bool active) const {
    return k < 2 ? Motor::inertia(k, active) : 1.0;
  }
  template <class X>
  ARM_INLINE constexpr void rates(const X* z, X u, X tm, X wm, X offset, bool active, X* f) const {
    const Voltages<X> requested = this->request_voltage(z, u, wm), V = limit_voltages(requested);
    const X across[] = {z[0], z[1], V.d};
    Motor::rates(across, V.q, tm, wm, offset, active, f);
    f[3] = control.I * (z[2] - z[0]) + control.I / Pd * (V.d - requested.d);
    f[4] = control.I * (u - z[1]) + control.I / Pq * (V.q - requested.q);
  }
  // The integral is set to hold a current that is set by hand.
  constexpr void set_current(Real* z, Real current) const {
    z[1] = current, z[4] = this->R_circuit() * current;
  }

  // ud has priority in the circle of the current limit, too.
  constexpr Real largest_current() const { return this->current_limit; }
  constexpr void set_further_input(int, Real* z, Real ud, Real) const {
    z[2] = clamp(ud, limit_or_none(this->current_limit));
  }
  template <class X>
  ARM_INLINE constexpr X largest_command(const X* z, Real) const {
    const X limit = X{} + limit_or_none(this->current_limit);
    const X left = (limit - z[2]) * (limit + z[2]);
    return square_root(select(left > 0.0, left, X{}));
  }

  template <class X>
  ARM_INLINE constexpr X supplied_power(const X* z, X u, X, X wm, bool) const {
    const Voltages<X> V = limit_voltages(request_voltage(z, u, wm));
    return 1.5 * (V.d * z[0] + V.q * z[1]);
  }
  template <class X>
  ARM_INLINE constexpr X supply_limit(const X*, X, X) const {
    return X{} + 0.375 / this->R * nominal.amplitude * nominal.amplitude;
  }

 private:
  static constexpr double kAlongFlux = 0.95;  // of the amplitude, at most
  template <class X>
  struct Voltages {
    X d, q;
  };
  constexpr Real P(Real L) const {
    return control.bandwidth > 0.0 ? control.tune_gains(nominal.R, L).P
                                   : control.P * L / nominal.Lq;
  }
  template <class X>
  ARM_INLINE constexpr Voltages<X> request_voltage(const X* z, X u, X wm) const {
    const X speed_voltage = control.feedforward * nominal.p * wm;
    Voltages<X> V = {Pd * (z[2] - z[0]) + z[3],
                     Pq * (u - z[1]) + z[4] + speed_voltage * nominal.psi};
    if constexpr (whole)
      V.d -= speed_voltage * nominal.Lq * z[1], V.q += speed_voltage * nominal.Ld * z[0];
    return V;
  }
  template <class X>
  ARM_INLINE constexpr Voltages<X> limit_voltages(const Voltages<X>& requested) const {
    if constexpr (!whole) return requested;
    const Real U = nominal.amplitude;
    const X d = clamp(requested.d, kAlongFlux * U);
    return {d, clamp(requested.q, square_root((U - d) * (U + d)))};
  }
};

}  // namespace arm
