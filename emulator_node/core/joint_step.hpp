// One joint's part of a linearly implicit step (linearly_implicit.hpp), as a table of numbers.
//
// With s = gamma h, each stage solves  (I - s A) k = r  for the rates k of i, tm, wm, q and v. A
// holds armature circuit, rotor, gear and viscous friction. The rows of i, tm and wm can be
// eliminated joint by joint: with L r_i, r_tm, Mm r_wm, r_q and the torque r_v on the right-hand
// sides of (1), (2) and (4),
//
//   k_i  = i_0 - c k_wm                    i_0 = L r_i / (L + s R),   c = s Kb / (L + s R)
//   k_tm = r_tm + s k_wm,    k_q = r_q + s k_v
//   dT   = Kg (Ng k_tm - k_q) + Dg (Ng k_wm - k_v) = X + G (Ng k_wm - k_v)
//                                          X = Kg (Ng r_tm - r_q),    G = s Kg + Dg
//   k_wm = alpha + s Ng G / D k_v          alpha = (Mm r_wm + s Kt i_0 - s Ng X) / D
//                                          D = Mm + s Kt c + s Ng^2 G
//
// so that s dT = s (X + G Ng alpha) - s b k_v with b = G (Mm + s Kt c) / D >= 0, and what remains
// is the links' equation of motion with a longer diagonal:
//
//   (M + s (Dl + b)) k_v = r_v + s (X + G Ng alpha)
//
// No division by L or Kg: L = 0 (the current follows at once) and very stiff gears need no case of
// their own.
//
// All this is linear in what the joint is when the step begins and in the k_v of the stages. So
// `respond` says it once, one quantity at a time, and a step multiplies with the numbers that come
// out.
#pragma once

#include "loops.hpp"
#include "scene.hpp"

namespace arm {

// What a joint's part of a step is linear in.
struct JointInput {
  double i, twist, twist_rate, v;  // A; Ng tm - q, Ng wm - v; speed of the link
  double drive;                    // V; or of a current at its limit, the rate it is given [A/s]
  double k1_v, k2_v;               // accelerations of the link, of the stages
};
inline constexpr int kJointInputs = 7;

struct JointResponse {
  double rhs_1, rhs_2;  // of the link's row: W k1_v = rhs_1 - nle, W k2_v = rhs_2 - sqrt(2) nle
  double i, tm, wm;     // what the step adds
};

struct JointTable {
  JointResponse of[kJointInputs];  // to 1 of each input
  double diagonal;                 // s (Dl + b), beside M
};

class JointStep {
 public:
  // `stages`: 1 or 2. `limited`: the current is at its limit and follows no voltage.
  JointStep(const Joint& of, double step, int stages, bool limited)
      : joint(of), h(step), two_stages(stages == 2), limited(limited), s(gamma(stages) * step) {
    const auto& [present, R, L, Kt, Kb, Mm, limit] = joint.motor;
    const auto& [rigid, Ng, Kg, Dg] = joint.gear;
    if (!present) return;
    per_volt = 1.0 / (L + s * R);
    c = limited ? 0.0 : s * Kb * per_volt;
    G = s * Kg + Dg;
    D = Mm + s * Kt * c + s * Ng * Ng * G;
    b = rigid ? Kt * c / (Ng * Ng) : G * (Mm + s * Kt * c) / D;
  }

  static constexpr double sqrt_2 = 1.4142135623730951;
  static constexpr double gamma(int stages) { return stages == 2 ? 1.0 - 0.5 * sqrt_2 : 1.0; }

  JointTable table() const {
    JointTable table = {{}, s * (joint.Dl + b)};
    for (int input = 0; input < kJointInputs; ++input) {
      double one[kJointInputs] = {};
      one[input] = 1.0;
      table.of[input] = respond({one[0], one[1], one[2], one[3], one[4], one[5], one[6]});
    }
    return table;
  }

 private:
  // Of i, tm, wm, q and v: rates k; or right-hand sides L r_i, r_tm, Mm r_wm, r_q, torque r_v.
  struct Five {
    double i, tm, wm, q, v;
  };

  JointResponse respond(const JointInput& x) const {
    const Five r1 = right_hand_side(x);
    const double rhs_1 = r1.v + s * link_side(r1, x.drive);
    const Five k1 = rates(r1, x.drive, x.k1_v);
    if (!two_stages) return {rhs_1, 0.0, h * k1.i, h * k1.tm, h * k1.wm};
    const Five r2 = {sqrt_2 * joint.motor.L * k1.i, sqrt_2 * k1.tm, sqrt_2 * joint.motor.Mm * k1.wm,
                     sqrt_2 * k1.q, sqrt_2 * (rhs_1 - s * (joint.Dl + b) * k1.v)};
    const double drive_2 = sqrt_2 * k1.i;
    const Five k2 = rates(r2, drive_2, x.k2_v);
    const double g = gamma(2);
    return {rhs_1, r2.v + s * link_side(r2, drive_2), h * (g * k1.i + 0.5 * k2.i),
            h * (g * k1.tm + 0.5 * k2.tm), h * (g * k1.wm + 0.5 * k2.wm)};
  }

  // (1), (2) and (4) for this joint, without nle.
  Five right_hand_side(const JointInput& x) const {
    const auto& [present, R, L, Kt, Kb, Mm, limit] = joint.motor;
    const auto& [rigid, Ng, Kg, Dg] = joint.gear;
    if (!present) return {0.0, 0.0, 0.0, x.v, -joint.Dl * x.v};
    const double wm = (x.twist_rate + x.v) / Ng;
    // Without inductance the current is no state: it follows voltage and speed.
    const double i = L > 0.0 || limited ? x.i : (x.drive - Kb * wm) / R;
    const double r_i = L > 0.0 && !limited ? x.drive - R * i - Kb * wm : 0.0;
    if (rigid) return {r_i, 0.0, 0.0, x.v, Kt / Ng * i - joint.Dl * x.v};
    const double T = Kg * x.twist + Dg * x.twist_rate;
    return {r_i, wm, Kt * i - Ng * T, x.v, T - joint.Dl * x.v};
  }

  double i_0(const Five& r, double drive) const { return limited ? drive : per_volt * r.i; }

  double alpha(const Five& r, double drive) const {
    const double X = joint.gear.Kg * (joint.gear.Ng * r.tm - r.q);
    return (r.wm + s * joint.motor.Kt * i_0(r, drive) - s * joint.gear.Ng * X) / D;
  }

  // X + G Ng alpha: what the eliminated motor adds to the link's row, over s.
  double link_side(const Five& r, double drive) const {
    const auto& [rigid, Ng, Kg, Dg] = joint.gear;
    if (!joint.motor.present) return 0.0;
    if (rigid) return joint.motor.Kt / Ng * i_0(r, drive);
    return Kg * (Ng * r.tm - r.q) + G * Ng * alpha(r, drive);
  }

  // All rates, from k_v.
  Five rates(const Five& r, double drive, double k_v) const {
    const auto& [rigid, Ng, Kg, Dg] = joint.gear;
    const double k_q = r.q + s * k_v;
    if (!joint.motor.present) return {0.0, 0.0, 0.0, k_q, k_v};
    const double k_wm = rigid ? k_v / Ng : alpha(r, drive) + s * Ng * G / D * k_v;
    const double k_i = i_0(r, drive) - c * k_wm;
    if (rigid) return {k_i, 0.0, 0.0, k_q, k_v};
    return {k_i, r.tm + s * k_wm, k_wm, k_q, k_v};
  }

  const Joint& joint;
  double h;
  bool two_stages, limited;
  double s, per_volt = 0.0, c = 0.0, G = 0.0, D = 0.0, b = 0.0;
};

}  // namespace arm
