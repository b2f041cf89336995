// Limits of coordinates, torques and tool at places along a path, in parts of them: the rows of
// timing.hpp, and by how much a timing exceeds them.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>

#include "chain.hpp"
#include "numerics/exponential.hpp"
#include "path.h"

namespace path {

constexpr int DERIVATIVES = 4;  // the curve itself among them
constexpr double TINY = 1e-12;
constexpr double WITHIN = 1e-9;    // of a piece of a timing: its ends are looked at from inside
constexpr double BESIDE = 1e-7;    // of sigma
constexpr double MIN_ROOM = 1e-6;  // of a limit, beside what the weight takes

// Coordinates and their first three derivatives by sigma at a place.
struct Joints {
  double s[DERIVATIVES];
  double f[DERIVATIVES][MAX_JOINTS];
};

// s over sigma, with its first three derivatives (timed_path.py, Ramps).
inline void ramps(double ramp, double sigma, double* s) {
  const double top = 1.0 / (1.0 - ramp);
  const bool falling = sigma > 0.5;
  const double x = (falling ? 1.0 - sigma : sigma) / ramp;
  if (x >= 1.0) {
    s[0] = top * ramp * (x - 0.5), s[1] = top, s[2] = s[3] = 0.0;
  } else {
    s[0] = top * ramp * x * x * x * (1.0 - 0.5 * x), s[1] = top * x * x * (3.0 - 2.0 * x);
    s[2] = top / ramp * 6.0 * x * (1.0 - x), s[3] = top / (ramp * ramp) * (6.0 - 12.0 * x);
  }
  if (falling) s[0] = 1.0 - s[0], s[2] = -s[2];
}

// Sigma of a place s.
inline double ramps_inverse(double ramp, double s) {
  const double top = 1.0 / (1.0 - ramp), within = s > 0.5 ? 1.0 - s : s;
  double sigma = within / top + 0.5 * ramp;
  if (sigma < ramp) {  // x^3 (1 - x / 2) rises on [0, 1]
    const double target = within / (top * ramp);
    double low = 0.0, high = 1.0, x = 0.5;
    for (int k = 0; k < 60 && high - low > 1e-12; ++k) {
      const double off = x * x * x * (1.0 - 0.5 * x) - target;
      if (std::fabs(off) < 1e-14) break;
      (off < 0.0 ? low : high) = x;
      const double newton = x - off / std::max(x * x * (3.0 - 2.0 * x), TINY);
      x = newton > low && newton < high ? newton : 0.5 * (low + high);
    }
    sigma = ramp * x;
  }
  return s > 0.5 ? 1.0 - sigma : sigma;
}

inline Joints joints_at(const path_curve& curve, double ramp, double sigma) {
  Joints at;
  ramps(ramp, sigma, at.s);
  const double* ends = curve.breaks + 1;
  const int64_t piece = std::upper_bound(ends, ends + curve.pieces - 1, at.s[0]) - ends;
  const double x = at.s[0] - curve.breaks[piece], s1 = at.s[1], s2 = at.s[2], s3 = at.s[3];
  const int32_t n = curve.columns, degrees = curve.degrees;
  const double* c = curve.coefficients + piece * degrees * n;
  for (int32_t j = 0; j < n; ++j) {
    double q[DERIVATIVES] = {0.0, 0.0, 0.0, 0.0};  // Horner's scheme, q[k] over k!
    for (int32_t d = degrees - 1; d >= 0; --d) {
      for (int k = DERIVATIVES - 1; k > 0; --k) q[k] = q[k] * x + q[k - 1];
      q[0] = q[0] * x + c[d * n + j];
    }
    const double q1 = q[1], q2 = 2.0 * q[2], q3 = 6.0 * q[3];
    at.f[0][j] = q[0], at.f[1][j] = q1 * s1, at.f[2][j] = q2 * s1 * s1 + q1 * s2;
    at.f[3][j] = q3 * s1 * s1 * s1 + 3.0 * q2 * s1 * s2 + q1 * s3;
  }
  return at;
}

// Frames of the links; q of the coordinates.
inline Frames frames_at(const path_arm& arm, const double* q) {
  double of[MAX_JOINTS];
  for (int32_t i = 0; i < arm.joints; ++i) {
    of[i] = arm.offset[i];
    for (int32_t j = 0; j < arm.coordinates; ++j)
      of[i] += arm.coupling[static_cast<int64_t>(i) * arm.coordinates + j] * q[j];
  }
  return Frames(arm, of);
}

// Torques of the coordinates; v, a of them.
inline void coordinate_torques(const path_arm& arm, const Frames& at, const double* v,
                               const double* a, double* tau) {
  const int32_t n = arm.coordinates;
  double of[3][MAX_JOINTS];
  for (int32_t i = 0; i < arm.joints; ++i) {
    const double* row = arm.coupling + static_cast<int64_t>(i) * n;
    of[0][i] = of[1][i] = 0.0;
    for (int32_t j = 0; j < n; ++j) of[0][i] += row[j] * v[j], of[1][i] += row[j] * a[j];
  }
  torques(arm, at, of[0], of[1], of[2]);
  std::fill(tau, tau + n, 0.0);
  for (int32_t i = 0; i < arm.joints; ++i)
    for (int32_t j = 0; j < n; ++j)
      tau[j] += arm.coupling[static_cast<int64_t>(i) * n + j] * of[2][i];
}

// Rows of one place; `loaded`: with torques.
struct RowsAt {
  double max_c;
  double first[3][2 * MAX_JOINTS + 1], third[3][MAX_JOINTS + 1];
  int32_t firsts, thirds;
};

inline double square(double x) { return x * x; }

// `same`: rows still has those of a place of the same torques.
inline void rows_at(const path_arm* arm, const path_limits& limits, int32_t n, const Joints& at,
                    RowsAt* rows, bool same = false) {
  rows->max_c = HUGE_VAL, rows->firsts = rows->thirds = 0;
  auto first = [&](double zero, double c, double d) {
    const int32_t k = rows->firsts++;
    rows->first[0][k] = zero, rows->first[1][k] = c, rows->first[2][k] = d;
  };
  auto third = [&](double c, double d, double e) {
    const int32_t k = rows->thirds++;
    rows->third[0][k] = c, rows->third[1][k] = d, rows->third[2][k] = e;
  };
  for (int32_t j = 0; j < n; ++j) {
    const double f1 = at.f[1][j], f2 = at.f[2][j], f3 = at.f[3][j], a = limits.acceleration[j],
                 k = limits.jerk[j];
    rows->max_c = std::min(rows->max_c, square(limits.speed[j] / std::max(std::fabs(f1), TINY)));
    first(0.0, f2 / a, 0.5 * f1 / a);
    third(f3 / k, 1.5 * f2 / k, 0.5 * f1 / k);
  }
  if (limits.requested > 0.0)
    rows->max_c = std::min(rows->max_c, 1.0 / square(std::max(limits.requested * at.s[1], TINY)));
  if (arm && same) {
    for (int32_t j = 0; j < n; ++j) rows->firsts += limits.torque[j] < HUGE_VAL;
  } else if (arm) {
    const double still[MAX_JOINTS] = {};
    double weight[MAX_JOINTS], rate[MAX_JOINTS], change[MAX_JOINTS];
    const Frames frames = frames_at(*arm, at.f[0]);
    coordinate_torques(*arm, frames, still, still, weight);
    coordinate_torques(*arm, frames, at.f[1], at.f[2], rate);
    coordinate_torques(*arm, frames, still, at.f[1], change);
    for (int32_t j = 0; j < n; ++j) {
      const double limit = limits.torque[j];
      if (limit < HUGE_VAL)
        first(weight[j] / limit, (rate[j] - weight[j]) / limit,
              0.5 * (change[j] - weight[j]) / limit);
    }
  }
  if (limits.length <= 0.0) return;
  const double g1 = limits.length * at.s[1], g2 = limits.length * at.s[2],
               g3 = limits.length * at.s[3], b = limits.tool_acceleration, k = limits.tool_jerk;
  rows->max_c = std::min(rows->max_c, square(limits.tool_speed / std::max(std::fabs(g1), TINY)));
  const int64_t part = std::min<int64_t>(
      std::lower_bound(limits.ends, limits.ends + limits.parts, at.s[0]) - limits.ends,
      limits.parts - 1);
  rows->max_c = std::min(rows->max_c, b / std::max(limits.curvature[part] * g1 * g1, TINY));
  first(0.0, g2 / b, 0.5 * g1 / b);
  third(g3 / k, 1.5 * g2 / k, 0.5 * g1 / k);
}

// Whether a torque exceeds its limit at a place, with c and its derivative.
inline bool overloaded(const path_arm& arm, const path_limits& limits, const Joints& at, double c,
                       double d) {
  double v[MAX_JOINTS], a[MAX_JOINTS], tau[MAX_JOINTS];
  const double rate = std::sqrt(c);
  for (int32_t j = 0; j < arm.coordinates; ++j)
    v[j] = at.f[1][j] * rate, a[j] = at.f[2][j] * c + 0.5 * at.f[1][j] * d;
  coordinate_torques(arm, frames_at(arm, at.f[0]), v, a, tau);
  for (int32_t j = 0; j < arm.coordinates; ++j)
    if (std::fabs(tau[j]) > limits.torque[j]) return true;
  return false;
}

// By how much a timing exceeds limits at the places where it is looked at, piece by piece.
struct Excess {
  const path_arm* arm;
  const path_curve& curve;
  const path_limits& limits;
  double ramp;
  int32_t intervals;
  const double* coefficients;
  double jerk_margin;
  double* keeps;  // (intervals), factors of c

  // `torques`: with those; they do not step where a third derivative does.
  void look(double sigma, bool torques) const {
    const double n = intervals, u = sigma * n;
    const int64_t piece = std::clamp<int64_t>(static_cast<int64_t>(u), 0, intervals - 1);
    const double *x = coefficients + piece, t = u - static_cast<double>(piece);
    const double k0 = 0.5 * (x[0] + x[1]), k1 = x[1] - x[0], k2 = 0.5 * (x[0] - 2.0 * x[1] + x[2]);
    const double c = k0 + t * (k1 + t * k2), d = n * (k1 + 2.0 * t * k2), e = 2.0 * n * n * k2;
    const Joints at = joints_at(curve, ramp, sigma);
    const bool loaded = arm && torques && overloaded(*arm, limits, at, c, d);
    RowsAt rows;
    rows_at(loaded ? arm : nullptr, limits, curve.columns, at, &rows);
    double excess = c / rows.max_c, jerk = 0.0;
    for (int32_t i = 0; i < rows.firsts; ++i) {
      const double moving = rows.first[1][i] * c + rows.first[2][i] * d;
      const double fixed = moving < 0.0 ? -rows.first[0][i] : rows.first[0][i];
      excess = std::max(excess, std::fabs(moving) / std::max(1.0 - fixed, MIN_ROOM));
    }
    for (int32_t i = 0; i < rows.thirds; ++i) {
      const double third = rows.third[0][i] * c + rows.third[1][i] * d + rows.third[2][i] * e;
      jerk = std::max(jerk, std::sqrt(c) * std::fabs(third));
    }
    if (jerk_margin * jerk > 1.0)
      excess = std::max(excess, arm::exponential(2.0 / 3.0 * arm::logarithm(jerk_margin * jerk)));
    keeps[piece] = std::min(keeps[piece], 1.0 / excess);
  }
};

}  // namespace path
