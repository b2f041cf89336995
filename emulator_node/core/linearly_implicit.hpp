// Linearly implicit schemes: implicit Euler, and the Rosenbrock method ROS2.
//
// Both solve, with s = gamma h,  (I - s A) k = r  for the rates k of the state x = (i, tm, wm, q,
// v), where A is the part of the Jacobian that is stiff and cheap: armature circuit, rotor, gear
// and viscous friction of each joint by itself. A leaves out how nle and M change with q and v.
//
//   implicit    k = f(x),                  x' = x + h k                        (gamma = 1)
//   rosenbrock  (I - s A) k1 = f(x)
//               (I - s A) k2 = f(x + h k1) - 2 k1,  x' = x + h (3 k1 + k2) / 2
//
// ROS2 is a W-method: of order 2 with any A (Verwer, Spee, Blom and Hundsdorfer, SIAM J. Sci.
// Comput. 20, 1999), and L-stable in what A holds for gamma = 1 - 1/sqrt(2).
//
// Joint by joint, the rows of i, tm and wm can be eliminated. With L r_i, r_tm, Mm r_wm, r_q and
// the torque r_v on the right-hand sides of (1), (2) and (4):
//
//   k_i  = i_0 - c k_wm                    i_0 = L r_i / (L + s R),   c = s Kb / (L + s R)
//   k_tm = r_tm + s k_wm,    k_q = r_q + s k_v
//   dT   = Kg (Ng k_tm - k_q) + Dg (Ng k_wm - k_v) = X + G (Ng k_wm - k_v)
//                                          X = Kg (Ng r_tm - r_q),    G = s Kg + Dg
//   k_wm = (Mm r_wm + s Kt i_0 - s Ng X) / D + (s Ng G / D) k_v,      D = Mm + s Kt c + s Ng^2 G
//
// so that s dT = s (X + G Ng alpha) - s b k_v with b = G (Mm + s Kt c) / D >= 0, and what remains
// is
//
//   (M + s (Dl + b)) k_v = r_v + s (X + G Ng alpha)
//
// the links' equation of motion with a longer diagonal. No division by L or Kg: L = 0 (the current
// follows at once) and very stiff gears need no case of their own.
#pragma once

#include "friction.hpp"
#include "links.hpp"
#include "motors.hpp"
#include "state.hpp"

namespace arm {

// What is left of one joint's motor after the elimination, for one s.
struct Elimination {
  double per_volt;   // 1 / (L + s R)
  double c;          // k_i = i_0 - c k_wm
  double inverse_D;  // 1 / D
  double b;          // on the diagonal beside Dl
};

// `limited`: the current is at its limit and follows no voltage (c = 0).
ARM_INLINE constexpr Elimination eliminate(const Joint& joint, double s, bool limited) {
  const auto& [present, R, L, Kt, Kb, Mm, limit] = joint.motor;
  const auto& [rigid, Ng, Kg, Dg] = joint.gear;
  if (!present) return {};
  const double per_volt = 1.0 / (L + s * R);
  const double c = limited ? 0.0 : s * Kb * per_volt;
  if (rigid) return {per_volt, c, 0.0, Kt * c / (Ng * Ng)};
  const double G = s * Kg + Dg;
  const double D = Mm + s * Kt * c + s * Ng * Ng * G;
  return {per_volt, c, 1.0 / D, G * (Mm + s * Kt * c) / D};
}

template <class S>
class LinearlyImplicit {
 public:
  static constexpr int N = S::N;
  static constexpr bool two_stages = S::scheme == Scheme::rosenbrock;
  static constexpr double gamma = two_stages ? 0.29289321881345254 : 1.0;  // 1 - 1/sqrt(2)

  explicit LinearlyImplicit(double step) : h(step), s(gamma * step) {
    for (int j = 0; j < N; ++j) {
      free[j] = eliminate(S::joint[j], s, false);
      limited[j] = eliminate(S::joint[j], s, true);
    }
  }

  // From sample k to k + 1 with the voltages V.
  ARM_INLINE void step(State<N>& x, const double (&V)[N]) {
    typename Links<S>::Dynamics links;
    Links<S>::dynamics(x.q, x.v, links);
    step(x, V, links);
  }

  // The same with the links' part at sample k from elsewhere; it is used up.
  ARM_INLINE void step(State<N>& x, const double (&V)[N], typename Links<S>::Dynamics& links) {
    Rates k1, k2;
    first_stage(x, V, links, k1);
    if constexpr (two_stages) {
      State<N> y = x;
      advance(y, k1, h);
      second_stage(y, V, k1, k2);
      advance(x, k1, 1.5 * h);
      advance(x, k2, 0.5 * h);
    } else {
      advance(x, k1, h);
    }
    friction.stop_at_reversal(x.v);
    for_each<N>([&](auto j) __attribute__((always_inline)) {
      follow_voltage(x, V, j);
      if (may_limit(j)) x.i[j] = clamp(x.i[j], S::joint[j].motor.current_limit);
    });
  }

 private:
  using Rates = State<N>;
  using Rows = State<N>;  // right-hand sides: L r_i, r_tm, Mm r_wm, r_q, and the torque r_v

  ARM_INLINE void first_stage(State<N>& x, const double (&V)[N], typename Links<S>::Dynamics& links,
                              Rates& k) {
    auto& W = links.M;
    Rows r;
    for_each<N>([&](auto j) __attribute__((always_inline)) {
      follow_voltage(x, V, j);
      choose_elimination(x, V, j);
      right_hand_side(x, V, links.nle, j, r);
      W.at[j][j] += carried_rotor(S::joint[j]) + s * (S::joint[j].Dl + motor[j].b);
      M_k1[j] = k.v[j] = r.v[j] + s * link_side(r, j);
    });
    friction.solve(W.at, x.v, k.v);
    for_each<N>([&](auto j) __attribute__((always_inline)) {
      M_k1[j] -= friction.force(j) + s * (S::joint[j].Dl + motor[j].b) * k.v[j];
      motor_side(r, j, k);
    });
  }

  // M(x) f_v(y) is wanted for the links. M(y) f_v(y) = T - Dl v - nle(y) is cheap, and in the
  // difference (M(x) - M(y)) f_v(y) the rates k1 may stand for f_v(y): the error is O(h^2), which
  // order 2 allows. So one inverse dynamics with the accelerations k1 does, and no second M.
  ARM_INLINE void second_stage(State<N>& y, const double (&V)[N], const Rates& k1, Rates& k) {
    typename Links<S>::Kinematics kinematics;
    double M_k1_and_nle[N];
    Rows r;
    Links<S>::kinematics(y.q, kinematics);
    Links<S>::inverse_dynamics(kinematics, y.v, k1.v, M_k1_and_nle);
    for_each<N>([&](auto j) __attribute__((always_inline)) {
      const Joint& joint = S::joint[j];
      follow_voltage(y, V, j);
      right_hand_side(y, V, M_k1_and_nle, j, r);
      r.i[j] -= 2.0 * joint.motor.L * k1.i[j];
      r.tm[j] -= 2.0 * k1.tm[j];
      r.wm[j] -= 2.0 * joint.motor.Mm * k1.wm[j];
      r.q[j] -= 2.0 * k1.q[j];
      r.v[j] -= M_k1[j] + carried_rotor(joint) * k1.v[j];
      forced_rate[j] = -k1.i[j];
      k.v[j] = r.v[j] + s * link_side(r, j);
    });
    friction.solve_again(k.v);
    for_each<N>([&](auto j) __attribute__((always_inline)) { motor_side(r, j, k); });
  }

  // Right-hand sides of (1), (2) and (4) for joint j; `nle` of (4) may hold inertia torques too.
  ARM_INLINE static void right_hand_side(const State<N>& x, const double (&V)[N],
                                         const double (&nle)[N], int j, Rows& r) {
    const auto& [present, R, L, Kt, Kb, Mm, limit] = S::joint[j].motor;
    const auto& [rigid, Ng, Kg, Dg] = S::joint[j].gear;
    const double T = drive_torque(S::joint[j], x, j);
    const double wm = rigid ? x.v[j] / Ng : x.wm[j];
    r.i[j] = present && L > 0.0 ? V[j] - R * x.i[j] - Kb * wm : 0.0;
    r.tm[j] = present && !rigid ? wm : 0.0;
    r.wm[j] = present && !rigid ? Kt * x.i[j] - Ng * T : 0.0;
    r.q[j] = x.v[j];
    r.v[j] = T - nle[j] - S::joint[j].Dl * x.v[j];
  }

  // i_0 of the elimination.
  ARM_INLINE double current_rate(const Rows& r, int j) const {
    return limiting(j) ? forced_rate[j] : motor[j].per_volt * r.i[j];
  }

  // X + G Ng alpha: what the eliminated motor adds to the link's row, over s.
  ARM_INLINE double link_side(const Rows& r, int j) const {
    const auto& [present, R, L, Kt, Kb, Mm, limit] = S::joint[j].motor;
    const auto& [rigid, Ng, Kg, Dg] = S::joint[j].gear;
    if (!present) return 0.0;
    if (rigid) return Kt / Ng * current_rate(r, j);
    const double X = Kg * (Ng * r.tm[j] - r.q[j]);
    return X + (s * Kg + Dg) * Ng * alpha(r, j);
  }

  ARM_INLINE double alpha(const Rows& r, int j) const {
    const auto& [present, R, L, Kt, Kb, Mm, limit] = S::joint[j].motor;
    const auto& [rigid, Ng, Kg, Dg] = S::joint[j].gear;
    const double X = Kg * (Ng * r.tm[j] - r.q[j]);
    return (r.wm[j] + s * Kt * current_rate(r, j) - s * Ng * X) * motor[j].inverse_D;
  }

  // The eliminated rates, from k_v.
  ARM_INLINE void motor_side(const Rows& r, int j, Rates& k) const {
    const auto& [rigid, Ng, Kg, Dg] = S::joint[j].gear;
    k.q[j] = r.q[j] + s * k.v[j];
    k.i[j] = k.tm[j] = k.wm[j] = 0.0;
    if (!S::joint[j].motor.present) return;
    const double k_wm =
        rigid ? k.v[j] / Ng : alpha(r, j) + s * Ng * (s * Kg + Dg) * motor[j].inverse_D * k.v[j];
    k.i[j] = current_rate(r, j) - motor[j].c * k_wm;
    if (rigid) return;
    k.wm[j] = k_wm;
    k.tm[j] = r.tm[j] + s * k_wm;
  }

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
  ARM_INLINE bool limiting(int j) const { return may_limit(j) && at_limit[j]; }

  // A current that would pass its limit in this step is led to the limit instead. Whether it would
  // is judged at the step's beginning: where a limit is reached or left the order is 1. It rises at
  // (V - Kb wm - R i) / L until it meets the limit, and then stays; it is begun where a straight
  // way to the limit has the same mean, and so the same impulse.
  ARM_INLINE void choose_elimination(State<N>& x, const double (&V)[N], int j) {
    motor[j] = free[j];
    if (!may_limit(j)) return;
    const auto& [present, R, L, Kt, Kb, Mm, limit] = S::joint[j].motor;
    const double wm = S::joint[j].gear.rigid ? x.v[j] / S::joint[j].gear.Ng : x.wm[j];
    const double i = (L * x.i[j] + h * (V[j] - Kb * wm)) / (L + h * R);
    at_limit[j] = i > limit || i < -limit;
    if (!at_limit[j]) return;
    motor[j] = limited[j];
    const double way = clamp(i, limit) - x.i[j];
    const double part_of_step = L * way / (h * (V[j] - Kb * wm - R * x.i[j]));
    const double straight = way * (part_of_step < 1.0 ? part_of_step : 1.0);
    x.i[j] += way - straight;
    forced_rate[j] = straight / h;
  }

  ARM_INLINE static void advance(State<N>& x, const Rates& k, double step) {
    for_each<N>([&](auto j) __attribute__((always_inline)) {
      x.i[j] += step * k.i[j];
      x.tm[j] += step * k.tm[j];
      x.wm[j] += step * k.wm[j];
      x.q[j] += step * k.q[j];
      x.v[j] += step * k.v[j];
    });
  }

  double h, s;
  Elimination free[N], limited[N], motor[N] = {};
  bool at_limit[N] = {};
  double forced_rate[N] = {};  // of a current at its limit [A/s]
  double M_k1[N] = {};         // M(x) k1 of the links
  Friction<S> friction;
};

}  // namespace arm
