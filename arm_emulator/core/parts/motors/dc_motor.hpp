// A direct-current motor: armature circuit, and the torque on its rotor.
//
//   (1)  L di/dt = V - (R + R_contact) i - Kb wm          torque  Kt i
//
// With L = 0 the current follows at once. At its limit the drive reduces the voltage so that the
// current stays there. Its mode (mode.hpp) is `active` there, and the mode's number is the limit,
// with the current's sign.
#pragma once

#include "numerics/number.hpp"
#include "parts/command.hpp"
#include "parts/mode.hpp"

namespace arm {

template <bool limited>
struct DcMotorOf {
  constexpr bool operator==(const DcMotorOf&) const = default;

  Real R;                    // ohm
  Real L;                    // H
  Real Kt;                   // N m/A
  Real Kb;                   // V s/rad
  Real Mm;                   // kg m2, with the gear's primary side
  Real current_limit = 0.0;  // A, of one that has a limit
  Real R_contact = 0.0;      // ohm, in series with the winding, which it does not heat

  static constexpr bool present = true;
  static constexpr int states = 1;  // i [A]
  static constexpr int modes = limited ? 1 : 0;

  // See drive.hpp.
  constexpr const DcMotorOf& linear() const { return *this; }

  static constexpr Command takes = Command::voltage;  // within the supply's
  constexpr Real largest_current() const { return current_limit; }

  // Factor of di/dt in (1), and the right-hand side of (1).
  constexpr Real inertia(int, bool active) const { return active ? 0.0 : L; }
  template <class X>
  ARM_INLINE constexpr void rates(const X* i, X V, X, X wm, X offset, bool active, X* f) const {
    f[0] = active ? offset - i[0] : V - R_circuit() * i[0] - Kb * wm;
  }
  template <class X>
  ARM_INLINE constexpr X torque(const X* i, X) const {
    return Kt * i[0];
  }
  template <class X>
  ARM_INLINE constexpr X current(const X* i) const {
    return i[0];
  }
  constexpr void set_current(Real* i, Real current) const { i[0] = current; }
  constexpr Real R_circuit() const { return R + R_contact; }

  // Set the current if it is algebraic.
  constexpr void set_algebraic_state(Real* i, Real V, Real wm) const {
    if (L == 0.0) i[0] = (V - Kb * wm) / R_circuit();
    if constexpr (limited) i[0] = clamp(i[0], current_limit);
  }

  // Whether (1) holds, of a motor around it (winding.hpp).
  constexpr bool obeys_circuit(bool active) const { return !active; }

  template <class X>
  ARM_INLINE constexpr Mask<X> is_regular(const X* i, X, X) const {
    return magnitude(i[0]) < current_limit;
  }
  constexpr Mode mode_at(const Real* i, Real V, Real wm) const {
    const Mode mode = beyond(i[0]);
    return mode.active && surplus(mode.offset, V, wm) * mode.offset < 0.0 ? Mode{} : mode;
  }
  constexpr Mode required_mode(const Real* i, Real V, Real wm, const Mode& mode) const {
    if (!mode.active) return beyond(i[0] * (1.0 - kRounding));
    return surplus(i[0], V, wm) * mode.offset < 0.0 ? Mode{} : mode;
  }
  constexpr Real margin(const Real* i, Real V, Real wm, const Mode& mode) const {
    if (!mode.active) {
      const Real now = L > 0.0 ? i[0] : (V - Kb * wm) / R_circuit();
      return current_limit * (1.0 + kRounding) - magnitude(now);
    }
    const Real rounding = kRounding * (magnitude(V) + R_circuit() * current_limit);
    const Real left = surplus(mode.offset, V, wm);
    return (mode.offset < 0.0 ? -left : left) + rounding;
  }
  constexpr void enforce_modes(Real* i, const Mode& mode) const {
    i[0] = mode.active ? mode.offset : clamp(i[0], current_limit);
  }

  template <class X>
  ARM_INLINE constexpr X stored_energy(const X* i) const {
    return 0.5 * L * i[0] * i[0];
  }
  template <class X>
  ARM_INLINE constexpr X dissipated_power(const X* i) const {
    return R_circuit() * i[0] * i[0];
  }
  template <class X>
  ARM_INLINE constexpr X copper_loss(const X* i) const {
    return R * i[0] * i[0];
  }
  // Power from the supply, and the surplus from unequal constants [W].
  template <class X>
  ARM_INLINE constexpr X supplied_power(const X* i, X V, X, X wm, bool active) const {
    const X applied = active ? R_circuit() * i[0] + Kb * wm : V;
    return applied * i[0] + (Kt - Kb) * wm * i[0];
  }
  // The most that it can be given at the voltage V, for the best i [W].
  template <class X>
  ARM_INLINE constexpr X supply_limit(const X*, X V, X wm) const {
    const X U = magnitude(V) + magnitude((Kt - Kb) * wm);
    return U * U / (4.0 * R);
  }

 private:
  constexpr Mode beyond(Real i) const {
    if (i >= current_limit) return {true, current_limit};
    if (i <= -current_limit) return {true, -current_limit};
    return {};
  }
  // The voltage that is left to raise the current [V]. Held at the limit, a current needs some in
  // the limit's way, or it would fall by itself.
  constexpr Real surplus(Real i, Real V, Real wm) const { return V - R_circuit() * i - Kb * wm; }
};

using DcMotor = DcMotorOf<false>;
using LimitedDcMotor = DcMotorOf<true>;

}  // namespace arm
