// The functions of path.h.
#include "path.h"

#include <vector>

#include "limits.hpp"
#include "timing.hpp"
#include "trace.hpp"

extern "C" {

void path_forward(const path_arm* arm, int32_t count, const double* q, double* p, double* R) {
  for (int64_t k = 0; k < count; ++k) {
    const path::Frames at(*arm, q + k * arm->joints);
    std::copy(at.p_tool.begin(), at.p_tool.end(), p + 3 * k);
    std::copy(at.R_tool.begin(), at.R_tool.end(), R + 9 * k);
  }
}

void path_torques(const path_arm* arm, int32_t count, const double* q, const double* v,
                  const double* a, double* tau) {
  const int64_t n = arm->joints;
  for (int64_t k = 0; k < count; ++k)
    path::torques(*arm, path::Frames(*arm, q + k * n), v + k * n, a + k * n, tau + k * n);
}

int32_t path_trace(const path_arm* arm, int32_t rows, int32_t count, const double* p,
                   const double* R, const double* goal, double* q) {
  return path::trace(*arm, rows, count, p, R, goal, q);
}

void path_spline(int32_t nodes, int32_t columns, double step, const double* y, double* m) {
  const int64_t n = nodes, w = columns;
  std::vector<double> work(n);
  const double per = 1.0 / (step * step);
  for (int64_t j = 0; j < w; ++j) {
    auto at = [&](int64_t i) { return y[i * w + j]; };
    if (n < 4) {
      for (int64_t i = 0; i < n; ++i)
        m[i * w + j] = n == 3 ? per * (at(0) - 2.0 * at(1) + at(2)) : 0.0;
      continue;
    }
    // By differences, so that a coordinate that stays gets exact zeros.
    auto end = [&](int64_t i, int64_t to) {
      return per * (2.0 * (at(i) - at(i + to)) - 3.0 * (at(i + to) - at(i + 2 * to)) +
                    (at(i + 2 * to) - at(i + 3 * to)));
    };
    m[j] = end(0, 1);
    m[(n - 1) * w + j] = end(n - 1, -1);
    // m[i-1] + 4 m[i] + m[i+1] = 6 y''
    work[1] = 4.0;
    for (int64_t i = 1; i < n - 1; ++i) {
      double right = 6.0 * per * (at(i - 1) - 2.0 * at(i) + at(i + 1));
      if (i == n - 2) right -= m[(n - 1) * w + j];
      if (i == 1) {
        right -= m[j];
      } else {
        work[i] = 4.0 - 1.0 / work[i - 1];
        right -= m[(i - 1) * w + j] / work[i - 1];
      }
      m[i * w + j] = right;
    }
    m[(n - 2) * w + j] /= work[n - 2];
    for (int64_t i = n - 3; i >= 1; --i)
      m[i * w + j] = (m[i * w + j] - m[(i + 1) * w + j]) / work[i];
  }
}

void path_rows(const path_arm* arm, const path_curve* curve, const path_limits* limits, double ramp,
               int32_t count, const double* sigma, double* max_c, double* firsts, double* thirds) {
  path::RowsAt at;
  for (int64_t p = 0; p < count; ++p) {
    // The end of a piece is the begin of the next.
    const bool same = p > 0 && sigma[p] - sigma[p - 1] < path::BESIDE;
    path::rows_at(arm, *limits, curve->columns, path::joints_at(*curve, ramp, sigma[p]), &at, same);
    max_c[p] = at.max_c;
    for (int64_t k = 0; k < 3; ++k) {
      std::copy_n(at.first[k], at.firsts, firsts + (k * count + p) * at.firsts);
      std::copy_n(at.third[k], at.thirds, thirds + (k * count + p) * at.thirds);
    }
  }
}

void path_keeps(const path_arm* arm, const path_curve* curve, const path_limits* limits,
                double ramp, int32_t intervals, const double* coefficients, int32_t looks,
                double jerk_margin, double* keeps) {
  std::fill_n(keeps, intervals, 1.0);
  const path::Excess excess{arm,       *curve,       *limits,     ramp,
                            intervals, coefficients, jerk_margin, keeps};
  for (int32_t m = 0; m < intervals; ++m)
    for (int32_t k = 0; k < looks; ++k) {
      const double within = std::clamp(k / (looks - 1.0), path::WITHIN, 1.0 - path::WITHIN);
      excess.look((m + within) / intervals, k > 0);  // its begin is the end of the one before
    }
  // Third derivatives step at the ends of the ramps and at the breaks of the curve.
  auto beside = [&](double sigma) {
    excess.look(sigma - path::BESIDE, false);
    excess.look(sigma + path::BESIDE, false);
  };
  beside(ramp);
  beside(1.0 - ramp);
  for (int32_t k = 1; k < curve->pieces; ++k) beside(path::ramps_inverse(ramp, curve->breaks[k]));
}

int32_t path_time(int32_t intervals, const double* max_c, int32_t firsts, const double* first_rows,
                  int32_t thirds, const double* third_rows, double gap, double* coefficients) {
  path::Timing timing(intervals, max_c, firsts, first_rows, thirds, third_rows);
  return timing.solve(gap, coefficients);
}
}
