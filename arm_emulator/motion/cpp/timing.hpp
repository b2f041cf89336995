// The timing of least duration along a given path, by an interior-point method.
//
// c(s) = (ds/dt)^2 is a quadratic spline. Speeds bound c, accelerations and torques are linear in
// (c, c'), jerks are sqrt(c) times what is linear in (c, c', c''): |g| <= 1 / sqrt(c), whose right
// side is replaced by its tangent at the newest c, which lies below it. So every step solves a
// convex problem within the limits and stays within them (convex-concave procedure). Each point
// depends on three coefficients, so Newton's matrix has two diagonals beside the main one.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "numerics/exponential.hpp"
#include "path.h"

namespace path {

constexpr int POINTS = 3;  // of a piece: begin, middle, end
constexpr double AT[POINTS] = {0.0, 0.5, 1.0};
constexpr double SHARE[POINTS] = {1.0 / 6.0, 4.0 / 6.0, 1.0 / 6.0};  // Simpson
constexpr double INSIDE = 0.8;        // of the fastest constant c: start of the search
constexpr double BEGIN = 3.0;         // sharpness of the first barrier, per row
constexpr double SHARPER = 20.0;      // from one barrier to the next
constexpr int MAX_NEWTON_STEPS = 12;  // at a barrier
constexpr int SIDE_BY_SIDE = 8;       // rows, whose product needs no logarithm on the way
constexpr double LONGER = 4.0;        // than the step before a step may be
constexpr double CENTRED = 1.0;       // Newton decrement at which a barrier is done

struct Timing {
  int32_t intervals, firsts, thirds;
  const double *max_c, *first_0, *first_c, *first_d, *third_c, *third_d, *third_e;
  std::vector<double> x, step, trial, gradient, band;        // band: (coefficients, 3)
  std::vector<double> u, top, f_0, f_c, f_d, t_c, t_d, t_e;  // in parts of the even timing

  Timing(int32_t pieces, const double* max_c_rows, int32_t first_count, const double* first_rows,
         int32_t third_count, const double* third_rows)
      : intervals(pieces), firsts(first_count), thirds(third_count), max_c(max_c_rows) {
    const int64_t n = coefficients(), p = points(), f = p * firsts, t = p * thirds;
    first_0 = first_rows, first_c = first_rows + f, first_d = first_rows + 2 * f;
    third_c = third_rows, third_d = third_rows + t, third_e = third_rows + 2 * t;
    for (auto* one : {&x, &step, &trial, &gradient}) one->resize(n);
    band.resize(3 * n);
    for (auto* one : {&u, &top}) one->resize(p);
    for (auto* one : {&f_0, &f_c, &f_d}) one->resize(f);
    for (auto* one : {&t_c, &t_d, &t_e}) one->resize(t);
  }

  int coefficients() const { return intervals + 2; }
  int64_t points() const { return static_cast<int64_t>(POINTS) * intervals; }

  // Weights of three coefficients in c, c', c'' at a point of a piece.
  void weights(int at, double* w0, double* w1, double* w2) const {
    const double t = AT[at], n = intervals;
    w0[0] = 0.5 * (1 - t) * (1 - t), w0[1] = 0.5 + t - t * t, w0[2] = 0.5 * t * t;
    w1[0] = -(1 - t) * n, w1[1] = (1 - 2 * t) * n, w1[2] = t * n;
    w2[0] = n * n, w2[1] = -2 * n * n, w2[2] = n * n;
  }

  // The fastest constant c; -1 and the point that does not even permit rest.
  double even(int32_t* at_fault) const {
    double c = 1e300;
    for (int64_t p = 0; p < points(); ++p) {
      c = std::min(c, max_c[p]);
      for (int64_t i = p * firsts; i < (p + 1) * firsts; ++i) {
        const double room = 1.0 - std::fabs(first_0[i]);
        if (!(room > 1e-6)) {
          *at_fault = static_cast<int32_t>(p);
          return -1.0;
        }
        // The side towards which it grows has the room that the constant part leaves there.
        const double side = first_c[i] < 0.0 ? 1.0 + first_0[i] : 1.0 - first_0[i];
        if (first_c[i] != 0.0) c = std::min(c, side / std::fabs(first_c[i]));
      }
      for (int64_t i = p * thirds; i < (p + 1) * thirds; ++i)
        if (third_c[i] != 0.0)
          c = std::min(c, arm::exponential(-2.0 / 3.0 * arm::logarithm(std::fabs(third_c[i]))));
    }
    return c;
  }

  void scale(double c) {
    const double root = c * std::sqrt(c);
    for (int64_t p = 0; p < points(); ++p) top[p] = std::min(max_c[p] / c, 1e12);
    for (int64_t i = 0; i < points() * firsts; ++i)
      f_0[i] = first_0[i], f_c[i] = c * first_c[i], f_d[i] = c * first_d[i];
    for (int64_t i = 0; i < points() * thirds; ++i)
      t_c[i] = root * third_c[i], t_d[i] = root * third_d[i], t_e[i] = root * third_e[i];
  }

  // Take the logarithm of a product that has grown or shrunk far.
  static void drain(double* product, double* sum) {
    if (*product > 1e-100 && *product < 1e100) return;
    *sum -= arm::logarithm(std::max(*product, 1e-300));
    *product = 1.0;
  }

  // Barrier function at y, sharp t; infinite outside. `u` has the c at which tangents touch.
  double value(const double* y, double t) const {
    double sum = 0.0;
    for (int k = 0; k < POINTS; ++k) {
      double w0[3], w1[3], w2[3];
      weights(k, w0, w1, w2);
      for (int32_t m = 0; m < intervals; ++m) {
        const int64_t p = static_cast<int64_t>(POINTS) * m + k;
        const double c = w0[0] * y[m] + w0[1] * y[m + 1] + w0[2] * y[m + 2];
        const double d = w1[0] * y[m] + w1[1] * y[m + 1] + w1[2] * y[m + 2];
        const double e = w2[0] * y[m] + w2[1] * y[m + 1] + w2[2] * y[m + 2];
        if (!(c > 0.0) || !(c < top[p])) return INFINITY;
        sum += t * SHARE[k] / intervals / std::sqrt(c) - arm::logarithm(top[p] - c);
        double product = 1.0, least = 1.0;
        const double *f0 = f_0.data() + p * firsts, *fc = f_c.data() + p * firsts,
                     *fd = f_d.data() + p * firsts;
        for (int32_t i = 0; i < firsts;) {
          double of_some = 1.0;
          for (const int32_t end = std::min(firsts, i + SIDE_BY_SIDE); i < end; ++i) {
            const double r = f0[i] + fc[i] * c + fd[i] * d, slack = 1.0 - r * r;
            least = std::min(least, slack);
            of_some *= slack;
          }
          product *= of_some;
          drain(&product, &sum);
        }
        if (!(least > 0.0)) return INFINITY;
        const double root = std::sqrt(u[p]), level = 1.5 / root - 0.5 * c / (u[p] * root);
        if (thirds && !(level > 0.0)) return INFINITY;
        const double *tc = t_c.data() + p * thirds, *td = t_d.data() + p * thirds,
                     *te = t_e.data() + p * thirds;
        for (int32_t i = 0; i < thirds;) {
          double of_some = 1.0;
          for (const int32_t end = std::min(thirds, i + SIDE_BY_SIDE); i < end; ++i) {
            const double r = tc[i] * c + td[i] * d + te[i] * e, slack = level * level - r * r;
            least = std::min(least, slack);
            of_some *= slack;
          }
          product *= of_some;
          drain(&product, &sum);
        }
        if (!(least > 0.0)) return INFINITY;
        sum -= arm::logarithm(std::max(product, 1e-300));
      }
    }
    return sum;
  }

  // Gradient and matrix at x, after the tangents are laid there.
  void derive(double t) {
    std::fill(gradient.begin(), gradient.end(), 0.0);
    std::fill(band.begin(), band.end(), 0.0);
    for (int k = 0; k < POINTS; ++k) {
      double w[3][3];
      weights(k, w[0], w[1], w[2]);
      for (int32_t m = 0; m < intervals; ++m) {
        const int64_t p = static_cast<int64_t>(POINTS) * m + k;
        double y[3] = {0.0, 0.0, 0.0};
        for (int a = 0; a < 3; ++a)
          for (int b = 0; b < 3; ++b) y[a] += w[a][b] * x[m + b];
        const double c = y[0], d = y[1], e = y[2], root = std::sqrt(c);
        u[p] = c;
        double g0, g1 = 0.0, g2 = 0.0, h00, h01 = 0.0, h11 = 0.0, h02 = 0.0, h12 = 0.0, h22 = 0.0;
        const double share = t * SHARE[k] / intervals, gone = 1.0 / (top[p] - c);
        g0 = -0.5 * share / (c * root) + gone;
        h00 = 0.75 * share / (c * c * root) + gone * gone;
        const double *f0 = f_0.data() + p * firsts, *fc = f_c.data() + p * firsts,
                     *fd = f_d.data() + p * firsts;
        for (int i = 0; i < firsts; ++i) {
          const double r = f0[i] + fc[i] * c + fd[i] * d, inverse = 1.0 / (1.0 - r * r);
          const double g = 2.0 * r * inverse, h = 2.0 * (1.0 + r * r) * inverse * inverse;
          g0 += g * fc[i], g1 += g * fd[i];
          h00 += h * fc[i] * fc[i], h01 += h * fc[i] * fd[i], h11 += h * fd[i] * fd[i];
        }
        const double level = 1.0 / root, fall = 0.5 / (c * root);  // level - fall (c_new - c)
        const double *tc = t_c.data() + p * thirds, *td = t_d.data() + p * thirds,
                     *te = t_e.data() + p * thirds;
        for (int i = 0; i < thirds; ++i) {
          const double r = tc[i] * c + td[i] * d + te[i] * e;
          const double inverse = 1.0 / (level * level - r * r);
          const double over = (level + r) * inverse, under = (level - r) * inverse;
          const double up = fall + tc[i], down = fall - tc[i], both = over * over + under * under;
          g0 += over * up + under * down;
          g1 += (over - under) * td[i], g2 += (over - under) * te[i];
          h00 += over * over * up * up + under * under * down * down;
          const double mixed = over * over * up - under * under * down;
          h01 += mixed * td[i], h02 += mixed * te[i];
          h11 += both * td[i] * td[i], h12 += both * td[i] * te[i], h22 += both * te[i] * te[i];
        }
        const double H[3][3] = {{h00, h01, h02}, {h01, h11, h12}, {h02, h12, h22}};
        for (int b = 0; b < 3; ++b) {
          gradient[m + b] += g0 * w[0][b] + g1 * w[1][b] + g2 * w[2][b];
          double Hw[3];
          for (int a = 0; a < 3; ++a)
            Hw[a] = H[a][0] * w[0][b] + H[a][1] * w[1][b] + H[a][2] * w[2][b];
          for (int a = b; a < 3; ++a)  // of row m + a, the element in column m + b
            band[3 * (m + a) + (a - b)] += w[0][a] * Hw[0] + w[1][a] * Hw[1] + w[2][a] * Hw[2];
        }
      }
    }
  }

  // Newton's step: band L L' step = -gradient. false: the matrix is not positive definite.
  bool newton() {
    const int n = coefficients();
    for (int i = 0; i < n; ++i) {
      double* row = band.data() + 3 * static_cast<int64_t>(i);  // [i][i], [i][i-1], [i][i-2]
      double sum = -gradient[i];
      if (i > 1) {
        row[2] /= row[-6];
        sum -= row[2] * step[i - 2];
      }
      if (i > 0) {
        row[1] = (row[1] - (i > 1 ? row[2] * row[-3 + 1] : 0.0)) / row[-3];
        sum -= row[1] * step[i - 1];
      }
      const double rest =
          row[0] - (i > 0 ? row[1] * row[1] : 0.0) - (i > 1 ? row[2] * row[2] : 0.0);
      if (!(rest > 0.0)) return false;
      row[0] = std::sqrt(rest);
      step[i] = sum / row[0];
    }
    for (int i = n - 1; i >= 0; --i) {
      if (i + 1 < n) step[i] -= band[3 * (i + 1) + 1] * step[i + 1];
      if (i + 2 < n) step[i] -= band[3 * (i + 2) + 2] * step[i + 2];
      step[i] /= band[3 * static_cast<int64_t>(i)];
    }
    return true;
  }

  double duration() const {
    double sum = 0.0;
    for (int64_t p = 0; p < points(); ++p) sum += SHARE[p % POINTS] / intervals / std::sqrt(u[p]);
    return sum;
  }

  int32_t solve(double gap, double* result) {
    int32_t at_fault = -1;
    const double c = even(&at_fault);
    if (c < 0.0) return at_fault;
    scale(c);
    const int n = coefficients();
    std::fill(x.begin(), x.end(), INSIDE);
    const double rows = static_cast<double>(points()) * (1.0 + 2.0 * firsts + 2.0 * thirds);
    for (double t = BEGIN * rows;; t *= SHARPER) {
      double length = 1.0;
      for (int k = 0; k < MAX_NEWTON_STEPS; ++k) {
        derive(t);
        if (!newton()) break;
        double slope = 0.0;
        for (int i = 0; i < n; ++i) slope += gradient[i] * step[i];
        if (-slope < CENTRED) break;
        const double here = value(x.data(), t);
        length = std::min(1.0, LONGER * length);
        for (; length > 1e-6; length *= 0.5) {
          for (int i = 0; i < n; ++i) trial[i] = x[i] + length * step[i];
          if (value(trial.data(), t) <= here + 0.1 * length * slope) break;
        }
        if (!(length > 1e-6)) break;
        x = trial;
      }
      derive(t);
      if (rows / t <= gap * duration()) break;
    }
    for (int i = 0; i < n; ++i) result[i] = c * x[i];
    return -1;
  }
};

}  // namespace path
