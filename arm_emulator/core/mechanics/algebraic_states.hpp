// Algebraic states, set from the other states and the commands: the current of a winding
// without inductance, the torque of a motor whose control has no bandwidth.
#pragma once

#include "mechanics/numbers.hpp"
#include "mechanics/state.hpp"

namespace arm {

// Set the algebraic states of all drives.
template <class S>
void follow_at_once(const Numbers<S>& n, State<S>& x, const Real* u) {
  n.for_each_drive([&]<class Drive>(const Drive& drive, int j) {
    // The compiler does not see that nothing happens to numbers with derivatives.
    if constexpr (kDifferentiates && !Drive::may_follow) return;
    auto at = input_of(drive, j, x, u[j]);
    drive.follow(at);
    put_states(drive, j, 0, at, x);
  });
}

// The links at (q, v) and the motors to match, without current or gear torque.
template <class S>
State<S> at_rest_behind(const Numbers<S>& n, const Real* q, const Real* v) {
  State<S> at = {};
  n.for_each_drive([&](const auto& drive, int j) {
    const auto behind = drive.at_rest_behind(q[j], v[j]);
    for (int k = 0; k < drive.states; ++k) at.z[k][j] = behind.z[k];
    at.q[j] = q[j];
    at.v[j] = v[j];
  });
  return at;
}
// Put the motors at these angles [rad] and speeds [rad/s], without current.
template <class S>
void put_motors(const Numbers<S>& n, const double* angle, const double* speed, State<S>& x) {
  n.for_each_drive([&](const auto& drive, int j) {
    auto at = input_of(drive, j, x, 0.0);
    drive.put_motor(at, 0.0, angle[j], speed[j]);
    put_states(drive, j, 0, at, x);
  });
}

// Whether a drive has states that are set at a step's start: those of a gear with memory, or an
// algebraic state of the motor on which nonlinear parts depend, which it may get by varied numbers.
template <class S>
constexpr bool jumps_with(Real varied) {
  Real p[kOwnNumbers<S> + 1] = {};
  for (Real& value : p) value = varied;
  return std::apply(
      [](const auto&... drive) {
        return (... || (drive.has_gear_memory || (drive.bends_motor && drive.follows_at_once())));
      },
      S::drives(p));
}
template <class S>
inline constexpr bool kJumps = jumps_with<S>(1.0) || jumps_with<S>(0.0);

// Set those states: torque ripple and load friction are evaluated there, and the command may have
// jumped since the last step. (The schemes' tables treat linear parts implicitly.)
template <class S, class X>
ARM_INLINE void begin_at_once(const Numbers<S, X>& n, State<S, X>& x, const X* u) {
  for (int lane = 0; lane < kWidth<X>; ++lane)
    n.for_each_drive_of(lane,
                        [&]<class Drive>(const Drive& drive, int j) __attribute__((always_inline)) {
                          if constexpr (Drive::bends_motor || Drive::has_gear_memory)
                            if (Drive::has_gear_memory || drive.follows_at_once()) {
                              auto at = input_in_lane(drive, j, x, u[j], lane);
                              if (Drive::bends_motor && drive.follows_at_once()) drive.follow(at);
                              drive.follow_twist(at);
                              put_states(drive, j, lane, at, x);
                            }
                        });
}

}  // namespace arm
