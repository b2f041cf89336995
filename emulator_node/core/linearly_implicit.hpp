// Linearly implicit schemes: implicit Euler, and the Rosenbrock method ROS2 in two forms.
//
// All solve  (I - s A) k = r,  s = gamma h,  for the rates k of the state x = (i, tm, wm, q, v),
// where A is the part of the Jacobian that is stiff and cheap: armature circuit, rotor, gear and
// viscous friction of each joint by itself (joint_step.hpp). A leaves out how nle and M change with
// q and v.
//
//   implicit      k = f(x),  x' = x + h k                                       (gamma = 1)
//   rosenbrock    (I - s A) k1 = f(x)
//                 (I - s A) K2 = f(x + h k1) - 2 k1,  x' = x + h (3 k1 + K2) / 2
//
// ROS2 is a W-method: of order 2 with any A (Verwer, Spee, Blom and Hundsdorfer, SIAM J. Sci.
// Comput. 20, 1999), and L-stable in what A holds for gamma = 1 - 1/sqrt(2). What A holds need not
// be evaluated a second time: f(x + h k1) = f(x) + h A k1 + d, where h A k1 = (k1 - f(x)) / gamma
// and d is what the links' part changes. With K2 = (1 - 1/gamma) k1 + k2 and 1/gamma - 2 = sqrt(2)
//
//                 (I - s A) k2 = sqrt(2) k1 + d,  x' = x + h (gamma k1 + k2 / 2)
//
// d has only torques on the links: M(x) k1 + nle(x) - M(y) k1 - nle(y) at y = x + h k1. (That is
// M(x) f_v(y) - M(x) f_v(x) with k1 in the place of f_v(y) where M(x) - M(y) multiplies it: the
// error is O(h^2), which order 2 allows.)
//
//   rosenbrock    works it out at y: one inverse dynamics with the accelerations k1.
//   extrapolated  takes what it was from the last step to this one: each step evaluates the links
//                 only once. The error is O(h^2) again; where an acceleration jumps it is O(h),
//                 but in the one step after it, which keeps the order.
#pragma once

#include "friction.hpp"
#include "joint_step.hpp"
#include "links.hpp"
#include "motors.hpp"
#include "state.hpp"

namespace arm {

template <class S>
class LinearlyImplicit {
 public:
  static constexpr int N = S::N;
  using Dynamics = typename Links<S>::Dynamics;

  explicit LinearlyImplicit(double step) : h(step) {
    for (int j = 0; j < N; ++j) {
      free[j] = JointStep(S::joint[j], h, stages, false).table();
      limited[j] = JointStep(S::joint[j], h, stages, true).table();
    }
  }

  // The links' accelerations in the first stage, and the torques M a + nle that they take there.
  struct Accelerations {
    double a[N], torque[N];
  };
  using Memory = Accelerations;  // what a step takes from the one before, beside the state

  // Begin at a state with no past.
  void reset(const State<N>& x) {
    if constexpr (!extrapolates) return;
    typename Links<S>::Kinematics kinematics;
    past = {};
    Links<S>::kinematics(x.q, kinematics);
    Links<S>::inverse_dynamics(kinematics, x.v, nullptr, past.torque);
  }
  const Memory& memory() const { return past; }
  void restore(const Memory& memory) { past = memory; }

  // From sample k to k + 1 with the voltages V. The links' part comes from `exchange`, which is
  // given the links as soon as they have moved on (two_threads.hpp).
  template <class Exchange>
  ARM_INLINE void step(State<N>& x, const double (&V)[N], Dynamics& links, Exchange& exchange) {
    JointInput z[N];
    Accelerations k1;
    double change[N] = {};
    for_each<N>([&](auto j) __attribute__((always_inline)) {
      z[j] = begin(x, V, j);
      k1.torque[j] = answer(&JointResponse::rhs_1, z[j], j);
    });
    exchange.take(links);
    for_each<N>([&](auto j) __attribute__((always_inline)) {
      links.M.at[j][j] += carried_rotor(S::joint[j]);
    });
    if constexpr (extrapolates) extrapolate_change(links, change);
    first_stage(x, links, z, k1);
    if constexpr (extrapolates) past = k1;
    if constexpr (S::scheme == Scheme::rosenbrock) evaluate_change(x, k1, change);
    if constexpr (stages == 2) second_stage(links, change, z);
    for_each<N>([&](auto j) __attribute__((always_inline)) {
      x.q[j] += h * (x.v[j] + gamma * h * (z[j].k1_v + 0.5 * z[j].k2_v));
      x.v[j] += h * (gamma * z[j].k1_v + 0.5 * z[j].k2_v);
    });
    friction.stop_at_reversal(x.v);
    exchange.give(x);
    for_each<N>([&](auto j) __attribute__((always_inline)) { finish_motor(x, V, z[j], j); });
  }

 private:
  static constexpr bool extrapolates = S::scheme == Scheme::extrapolated;
  static constexpr int stages = S::scheme == Scheme::implicit ? 1 : 2;
  static constexpr double sqrt_2 = JointStep::sqrt_2;
  static constexpr double gamma = JointStep::gamma(stages);

  ARM_INLINE JointInput begin(State<N>& x, const double (&V)[N], int j) {
    const auto& [rigid, Ng, Kg, Dg] = S::joint[j].gear;
    follow_voltage(x, V, j);
    double drive = V[j];
    table[j] = &free[j];
    if (may_limit(j)) approach_limit(x, V, j, drive);
    const bool elastic = S::joint[j].motor.present && !rigid;
    const double twist = elastic ? Ng * x.tm[j] - x.q[j] : 0.0;
    const double twist_rate = elastic ? Ng * x.wm[j] - x.v[j] : 0.0;
    return {x.i[j], twist, twist_rate, x.v[j], drive, 0.0, 0.0};
  }

  ARM_INLINE void first_stage(const State<N>& x, Dynamics& links, JointInput (&z)[N],
                              Accelerations& k1) {
    for_each<N>([&](auto j) __attribute__((always_inline)) {
      k1.a[j] = k1.torque[j] - links.nle[j];
      links.M.at[j][j] += of(j).diagonal;
    });
    friction.solve(links.M.at, x.v, k1.a);
    for_each<N>([&](auto j) __attribute__((always_inline)) {
      z[j].k1_v = k1.a[j];
      k1.torque[j] -= friction.force(j) + of(j).diagonal * k1.a[j];
    });
  }

  ARM_INLINE void second_stage(const Dynamics& links, const double (&change)[N],
                               JointInput (&z)[N]) const {
    double k2[N];
    for_each<N>([&](auto j) __attribute__((always_inline)) {
      const double rest = change[j] - sqrt_2 * (links.nle[j] + friction.force(j));
      k2[j] = answer(&JointResponse::rhs_2, z[j], j) + rest;
    });
    friction.solve_again(k2);
    for_each<N>([&](auto j) __attribute__((always_inline)) { z[j].k2_v = k2[j]; });
  }

  // d of `rosenbrock`.
  ARM_INLINE void evaluate_change(const State<N>& x, const Accelerations& k1,
                                  double (&change)[N]) const {
    typename Links<S>::Kinematics kinematics;
    double q[N], v[N];
    for_each<N>([&](auto j) __attribute__((always_inline)) {
      q[j] = x.q[j] + h * (x.v[j] + gamma * h * k1.a[j]);
      v[j] = x.v[j] + h * k1.a[j];
    });
    Links<S>::kinematics(q, kinematics);
    Links<S>::inverse_dynamics(kinematics, v, k1.a, change);
    for_each<N>([&](auto j) __attribute__((always_inline)) {
      change[j] = k1.torque[j] - change[j] - carried_rotor(S::joint[j]) * k1.a[j];
    });
  }

  // d of `extrapolated`: the torques M a + nle, for the accelerations of the step before, there and
  // here.
  ARM_INLINE void extrapolate_change(const Dynamics& links, double (&change)[N]) const {
    const auto& M = links.M.at;
    for_each<N>([&](auto j) __attribute__((always_inline)) {
      change[j] = past.torque[j] - links.nle[j] - M[j][j] * past.a[j];
    });
    for_each<N>([&](auto j) __attribute__((always_inline)) {
      for_each_from<N>(next(j), [&](auto k) __attribute__((always_inline)) {
        change[j] -= M[j][k] * past.a[k];
        change[k] -= M[j][k] * past.a[j];
      });
    });
  }

  ARM_INLINE void finish_motor(State<N>& x, const double (&V)[N], const JointInput& z,
                               int j) const {
    if (S::joint[j].motor.present) {
      x.i[j] += answer(&JointResponse::i, z, j);
      if (!S::joint[j].gear.rigid) {
        x.tm[j] += answer(&JointResponse::tm, z, j);
        x.wm[j] += answer(&JointResponse::wm, z, j);
      }
    }
    follow_voltage(x, V, j);
    if (may_limit(j)) x.i[j] = clamp(x.i[j], S::joint[j].motor.current_limit);
  }

  // One line of joint j's table, times its input.
  ARM_INLINE double answer(double JointResponse::* line, const JointInput& z, int j) const {
    const double inputs[] = {z.i, z.twist, z.twist_rate, z.v, z.drive, z.k1_v, z.k2_v};
    double sum = 0.0;
    for_each<kJointInputs>([&](auto input) __attribute__((always_inline)) {
      if (matters(j, input)) sum += of(j).of[input].*line * inputs[input];
    });
    return sum;
  }

  // Without a motor, with a rigid gear or in one stage, most of the table is zero.
  static ARM_INLINE constexpr bool matters(int j, int input) {
    if constexpr (N > kUnrollLimit) return true;
    const bool motor = S::joint[j].motor.present, elastic = motor && !S::joint[j].gear.rigid;
    const bool each[] = {motor, elastic, elastic, true, motor, true, stages == 2};
    return each[input];
  }

  ARM_INLINE const JointTable& of(int j) const { return may_limit(j) ? *table[j] : free[j]; }

  // Without inductance the current is no state: it follows voltage and speed.
  ARM_INLINE static void follow_voltage(State<N>& x, const double (&V)[N], int j) {
    const auto& [present, R, L, Kt, Kb, Mm, limit] = S::joint[j].motor;
    if (!present || L > 0.0) return;
    const double wm = S::joint[j].gear.rigid ? x.v[j] / S::joint[j].gear.Ng : x.wm[j];
    const double i = (V[j] - Kb * wm) / R;
    x.i[j] = limit > 0.0 ? clamp(i, limit) : i;
  }

  static ARM_INLINE constexpr bool may_limit(int j) {
    return S::joint[j].motor.present && S::joint[j].motor.current_limit > 0.0;
  }

  // A current that would pass its limit in this step is led to the limit instead. Whether it would
  // is judged at the step's beginning: where a limit is reached or left the order is 1. It rises at
  // (V - Kb wm - R i) / L until it meets the limit, and then stays; it is begun where a straight
  // way to the limit has the same mean, and so the same impulse.
  ARM_INLINE void approach_limit(State<N>& x, const double (&V)[N], int j, double& drive) {
    const auto& [present, R, L, Kt, Kb, Mm, limit] = S::joint[j].motor;
    const double wm = S::joint[j].gear.rigid ? x.v[j] / S::joint[j].gear.Ng : x.wm[j];
    const double i = (L * x.i[j] + h * (V[j] - Kb * wm)) / (L + h * R);
    if (i <= limit && i >= -limit) return;
    table[j] = &limited[j];
    const double way = clamp(i, limit) - x.i[j];
    const double part_of_step = L * way / (h * (V[j] - Kb * wm - R * x.i[j]));
    const double straight = way * (part_of_step < 1.0 ? part_of_step : 1.0);
    x.i[j] += way - straight;
    drive = straight / h;
  }

  double h;
  JointTable free[N], limited[N];
  const JointTable* table[N];  // that serves in this step
  Memory past = {};
  Friction<S> friction;
};

}  // namespace arm
