// The functions of way.h.
#include "way.h"

#include "limits.hpp"
#include "timing.hpp"
#include "trace.hpp"

extern "C" {

void way_forward(const way_arm* arm, int32_t count, const double* q, double* p, double* R) {
  for (int64_t k = 0; k < count; ++k) {
    const way::Frames at(*arm, q + k * arm->joints);
    std::copy(at.p_tool.begin(), at.p_tool.end(), p + 3 * k);
    std::copy(at.R_tool.begin(), at.R_tool.end(), R + 9 * k);
  }
}

void way_torques(const way_arm* arm, int32_t count, const double* q, const double* v,
                 const double* a, double* tau) {
  const int64_t n = arm->joints;
  for (int64_t k = 0; k < count; ++k)
    way::torques(*arm, way::Frames(*arm, q + k * n), v + k * n, a + k * n, tau + k * n);
}

int32_t way_trace(const way_arm* arm, int32_t rows, int32_t count, const double* p, const double* R,
                  const double* goal, double* q) {
  return way::trace(*arm, rows, count, p, R, goal, q);
}

void way_spline(int32_t nodes, int32_t columns, double step, const double* y, double* m,
                double* work) {
  const int64_t n = nodes, w = columns;
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

void way_rows(const way_arm* arm, const way_curve* curve, const way_limits* limits, double ramp,
              int32_t count, const double* sigma, double* most, double* firsts, double* thirds) {
  way::RowsAt at;
  for (int64_t p = 0; p < count; ++p) {
    // The end of a piece is the begin of the next.
    const bool same = p > 0 && sigma[p] - sigma[p - 1] < way::BESIDE;
    way::rows_at(arm, *limits, curve->columns, way::joints_at(*curve, ramp, sigma[p]), &at, same);
    most[p] = at.most;
    for (int64_t k = 0; k < 3; ++k) {
      std::copy_n(at.first[k], at.firsts, firsts + (k * count + p) * at.firsts);
      std::copy_n(at.third[k], at.thirds, thirds + (k * count + p) * at.thirds);
    }
  }
}

void way_keeps(const way_arm* arm, const way_curve* curve, const way_limits* limits, double ramp,
               int32_t intervals, const double* coefficients, int32_t looks, double jerk_margin,
               double* keeps) {
  std::fill_n(keeps, intervals, 1.0);
  const way::Excess excess{arm, *curve, *limits, ramp, intervals, coefficients, jerk_margin, keeps};
  for (int32_t m = 0; m < intervals; ++m)
    for (int32_t k = 0; k < looks; ++k) {
      const double within = std::clamp(k / (looks - 1.0), way::WITHIN, 1.0 - way::WITHIN);
      excess.look((m + within) / intervals, k > 0);  // its begin is the end of the one before
    }
  // Third derivatives step at the ends of the ramps and at the breaks of the curve.
  auto beside = [&](double sigma) {
    excess.look(sigma - way::BESIDE, false);
    excess.look(sigma + way::BESIDE, false);
  };
  beside(ramp);
  beside(1.0 - ramp);
  for (int32_t k = 1; k < curve->pieces; ++k) beside(way::ramps_inverse(ramp, curve->breaks[k]));
}

int64_t way_work(int32_t intervals, int32_t firsts, int32_t thirds) {
  return way::Timing::work(intervals, firsts, thirds);
}

int32_t way_time(int32_t intervals, const double* most, int32_t firsts, const double* firsts_0,
                 const double* firsts_c, const double* firsts_d, int32_t thirds,
                 const double* thirds_c, const double* thirds_d, const double* thirds_e, double gap,
                 double* work, double* coefficients) {
  way::Timing timing{intervals, firsts,   thirds,  most,    firsts_0, firsts_c, firsts_d, thirds_c,
                     thirds_d,  thirds_e, nullptr, nullptr, nullptr,  nullptr,  nullptr,  nullptr,
                     nullptr,   nullptr,  nullptr, nullptr, nullptr,  nullptr,  nullptr};
  timing.place(work);
  return timing.solve(gap, coefficients);
}
}
