// Algebraic states, set from the other states and the commands: the current of a winding
// without inductance, the torque of a motor whose control has no bandwidth.
#pragma once

#include "mechanics/numbers.hpp"
#include "mechanics/state.hpp"

namespace arm {

// Set the algebraic states of all drives.
template <class S>
void set_algebraic_states(const Numbers<S>& n, State<S>& x, const Real* u) {
  n.for_each_drive([&]<class Drive>(const Drive& drive, int j) {
    // The compiler does not see that nothing happens to numbers with derivatives.
    if constexpr (kDifferentiates && !Drive::can_have_algebraic_state) return;
    auto at = input_of(drive, j, x, u[j]);
    drive.set_algebraic_state(at);
    store_states(drive, j, 0, at, x);
  });
}

// The links at (q, v) and the motors to match, without current or gear torque.
template <class S>
State<S> make_rest_state(const Numbers<S>& n, const Real* q, const Real* v) {
  State<S> at = {};
  n.for_each_drive([&](const auto& drive, int j) {
    const auto behind = drive.make_rest_state(q[j], v[j]);
    for (int k = 0; k < drive.states; ++k) at.z[k][j] = behind.z[k];
    at.q[j] = q[j];
    at.v[j] = v[j];
  });
  return at;
}
// Put the motors at these angles [rad] and speeds [rad/s], without current.
template <class S>
void set_motors(const Numbers<S>& n, const double* angle, const double* speed, State<S>& x) {
  n.for_each_drive([&](const auto& drive, int j) {
    auto at = input_of(drive, j, x, 0.0);
    drive.set_motor(at, 0.0, angle[j], speed[j]);
    store_states(drive, j, 0, at, x);
  });
}

// Whether a drive has states that are set at a step's start: those of a gear with memory, or an
// algebraic state of the motor on which nonlinear parts depend, which it may get by varied numbers.
template <class S>
constexpr bool has_start_states(Real varied) {
  Real p[kOwnNumbers<S> + 1] = {};
  for (Real& value : p) value = varied;
  return std::apply(
      [](const auto&... drive) {
        return (... || (drive.has_gear_memory ||
                        (drive.is_motor_nonlinear && drive.has_algebraic_state())));
      },
      S::drives(p));
}
template <class S>
inline constexpr bool kHasStartStates = has_start_states<S>(1.0) || has_start_states<S>(0.0);

// Set those states: torque ripple and load friction are evaluated there, and the command may have
// jumped since the last step. (The schemes' tables treat linear parts implicitly.)
template <class S, class X>
ARM_INLINE void set_start_states(const Numbers<S, X>& n, State<S, X>& x, const X* u) {
  for (int lane = 0; lane < kWidth<X>; ++lane)
    n.for_each_drive_of(lane,
                        [&]<class Drive>(const Drive& drive, int j) __attribute__((always_inline)) {
                          if constexpr (Drive::is_motor_nonlinear || Drive::has_gear_memory)
                            if (Drive::has_gear_memory || drive.has_algebraic_state()) {
                              auto at = input_in_lane(drive, j, x, u[j], lane);
                              if (Drive::is_motor_nonlinear && drive.has_algebraic_state())
                                drive.set_algebraic_state(at);
                              drive.update_gear_memory(at);
                              store_states(drive, j, lane, at, x);
                            }
                        });
}

}  // namespace arm
