// A direct-current motor: armature circuit, and the torque on its rotor.
//
//   (1)  L di/dt = V - R i - Kb wm          torque  Kt i
//
// With L = 0 the current follows at once. A current at its limit follows no voltage: the drive
// takes back as much of it as holds the limit.
#pragma once

#include "number.hpp"

namespace arm {

struct DcMotor {
  double R;                    // ohm
  double L;                    // H
  double Kt;                   // N m/A
  double Kb;                   // V s/rad
  double Mm;                   // kg m2, with the gear's primary side
  double current_limit = 0.0;  // A; 0: none

  static constexpr bool present = true;
  static constexpr int states = 1;  // i [A]

  // See drive.hpp.
  constexpr const DcMotor& linear() const { return *this; }

  constexpr bool has_limit() const { return current_limit > 0.0; }
  // What stands before di/dt in (1), and (1) itself. `side` is 1 or -1 at a limit, 0 within: then
  // the current is what the limit says.
  constexpr double inertia_of_current(bool limited) const { return limited ? 0.0 : L; }
  template <class X>
  ARM_INLINE constexpr X circuit(X i, X V, X wm, X side, bool limited) const {
    return limited ? side * current_limit - i : V - R * i - Kb * wm;
  }
  template <class X>
  ARM_INLINE constexpr X torque(X i) const {
    return Kt * i;
  }

  // The current of a motor without inductance, were there no limit.
  constexpr double current_at_once(double V, double wm) const { return (V - Kb * wm) / R; }

  // The limit that a current is at or beyond: 1 or -1, or 0 for none.
  constexpr double side_of(double i) const {
    return i >= current_limit ? 1.0 : i <= -current_limit ? -1.0 : 0.0;
  }

  // The same for a current beyond it by more than rounding.
  constexpr double side_beyond(double i) const { return side_of(i * (1.0 - 1e-12)); }

  // The voltage that is left to raise the current [V]. Held at the limit `side`, a current needs
  // side * surplus >= 0, or it would fall by itself.
  template <class X>
  ARM_INLINE constexpr X surplus(X i, X V, X wm) const {
    return V - R * i - Kb * wm;
  }

  template <class X>
  ARM_INLINE constexpr X stored(X i) const {
    return 0.5 * L * i * i;
  }
  template <class X>
  ARM_INLINE constexpr X dissipated(X i) const {
    return R * i * i;
  }
  // What it takes from its supply, and what differing constants give it from nowhere [W].
  template <class X>
  ARM_INLINE constexpr X given(X i, X V, X wm, bool limited) const {
    const X applied = limited ? R * i + Kb * wm : V;
    return applied * i + (Kt - Kb) * wm * i;
  }
  // The most that it can be given at the voltage V, for the best i [W].
  template <class X>
  ARM_INLINE constexpr X given_at_most(X V, X wm) const {
    const X U = magnitude(V) + magnitude((Kt - Kb) * wm);
    return U * U / (4.0 * R);
  }
};

// A joint that nothing drives.
struct NoMotor {
  static constexpr bool present = false;
  static constexpr int states = 0;
  static constexpr double Mm = 0.0, current_limit = 0.0;
  constexpr const NoMotor& linear() const { return *this; }
  constexpr bool has_limit() const { return false; }
};

}  // namespace arm
