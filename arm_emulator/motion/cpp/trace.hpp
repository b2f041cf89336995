// Joint coordinates along a path of the tool: Newton's method from pose to pose.
#pragma once

#include <algorithm>

#include "chain.hpp"

namespace path {

constexpr double THERE = 1e-10;  // rad, or m per reach
constexpr int MAX_STEPS = 12;    // from one pose to the next; two or three do
constexpr double LONGEST = 0.5;  // rad, of a step: a longer one leaves the path
constexpr double DAMPING = 1e-11;

// The scaled error of the tool, and its Jacobian by scaled coordinates, (rows, joints).
struct Task {
  double e[6], J[6][MAX_JOINTS];
  double size = 0.0;

  Task(const path_arm& arm, int rows, const double* q, const Vector& p, const Matrix& R) {
    const int n = arm.coordinates;
    double moved[MAX_JOINTS];
    for (int i = 0; i < arm.joints; ++i) {
      moved[i] = arm.offset[i];
      for (int j = 0; j < n; ++j) moved[i] += arm.coupling[i * n + j] * q[j];
    }
    const Frames at(arm, moved);
    for (int r = 0; r < rows; ++r) std::fill(J[r], J[r] + n, 0.0);
    const Vector offset = p - at.p_tool;
    for (int r = 0; r < 3; ++r) e[r] = offset[r] / arm.reach;
    if (rows == 6) {
      const Matrix& T = at.R_tool;
      const Matrix back = {T[0], T[3], T[6], T[1], T[4], T[7], T[2], T[5], T[8]};
      const Vector turned = rotation_vector(R * back);
      for (int r = 0; r < 3; ++r) e[3 + r] = turned[r];
    }
    for (int r = 0; r < rows; ++r) size += e[r] * e[r];
    size = std::sqrt(size);
    for (int i = arm.tool_parent; i >= 0; i = arm.parent[i]) {
      const Vector& z = at.axis[i];
      const Vector v = arm.slides[i] ? z : cross(z, at.p_tool - at.p[i]);
      for (int j = 0; j < n; ++j) {
        const double share = arm.coupling[i * n + j] * arm.scale[j];
        if (share == 0.0) continue;
        for (int r = 0; r < 3; ++r) {
          J[r][j] += share * v[r] / arm.reach;
          if (rows == 6 && !arm.slides[i]) J[3 + r][j] += share * z[r];
        }
      }
    }
  }
};

// Solve A x = b of size n, A symmetric and positive definite, by Cholesky; b becomes x.
inline bool solve(int n, double (*A)[MAX_JOINTS], double* b) {
  for (int i = 0; i < n; ++i) {
    for (int k = 0; k <= i; ++k) {
      double sum = A[i][k];
      for (int m = 0; m < k; ++m) sum -= A[i][m] * A[k][m];
      if (k < i)
        A[i][k] = sum / A[k][k];
      else if (sum > 0.0)
        A[i][i] = std::sqrt(sum);
      else
        return false;
    }
    double sum = b[i];
    for (int m = 0; m < i; ++m) sum -= A[i][m] * b[m];
    b[i] = sum / A[i][i];
  }
  for (int i = n - 1; i >= 0; --i) {
    for (int m = i + 1; m < n; ++m) b[i] -= A[m][i] * b[m];
    b[i] /= A[i][i];
  }
  return true;
}

// The shortest step of the scaled coordinates that removes the error in first order.
inline bool shortest_step(const Task& task, int rows, int n, bool wide, double* step) {
  double A[MAX_JOINTS][MAX_JOINTS];
  // Wide: J' (J J')^-1 e; else (J' J)^-1 J' e.
  const int m = wide ? rows : n;
  for (int i = 0; i < m; ++i)
    for (int k = 0; k <= i; ++k) {
      double sum = i == k ? DAMPING : 0.0;
      if (wide)
        for (int j = 0; j < n; ++j) sum += task.J[i][j] * task.J[k][j];
      else
        for (int r = 0; r < rows; ++r) sum += task.J[r][i] * task.J[r][k];
      A[i][k] = sum;
    }
  double b[MAX_JOINTS];
  for (int i = 0; i < m; ++i) {
    b[i] = wide ? task.e[i] : 0.0;
    if (!wide)
      for (int r = 0; r < rows; ++r) b[i] += task.J[r][i] * task.e[r];
  }
  if (!solve(m, A, b)) return false;
  for (int j = 0; j < n; ++j) {
    step[j] = wide ? 0.0 : b[j];
    if (wide)
      for (int r = 0; r < rows; ++r) step[j] += task.J[r][j] * b[r];
  }
  return true;
}

// Move q so that the tool is in a pose; false: none found nearby.
inline bool reach(const path_arm& arm, int rows, const Vector& p, const Matrix& R, double* q) {
  const int n = arm.coordinates;
  double before = 1e300;
  for (int k = 0; k < MAX_STEPS; ++k) {
    const Task task(arm, rows, q, p, R);
    if (!(task.size < 1e300)) return false;
    if (task.size <= THERE) return true;
    if (k > 2 && task.size > 0.5 * before) return task.size <= 100.0 * THERE;
    before = task.size;
    double step[MAX_JOINTS], longest = 0.0;
    if (!shortest_step(task, rows, n, arm.tool_coordinates >= rows, step)) return false;
    for (int j = 0; j < n; ++j) longest = std::max(longest, std::fabs(step[j]));
    if (!(longest < LONGEST)) return false;
    for (int j = 0; j < n; ++j) q[j] += arm.scale[j] * step[j];
  }
  return false;
}

inline int trace(const path_arm& arm, int rows, int count, const double* p, const double* R,
                 const double* goal, double* q) {
  const int n = arm.coordinates;
  for (int k = 0; k < count; ++k) {
    const double* from = q + static_cast<std::ptrdiff_t>(k) * n;
    double* to = q + static_cast<std::ptrdiff_t>(k + 1) * n;
    for (int j = 0; j < n; ++j) {
      double step = 0.0;
      if (goal)
        step = (goal[j] - from[j]) / (count - k);
      else if (k > 0)
        step = from[j] - from[j - n];
      to[j] = from[j] + step;
    }
    if (!reach(arm, rows, vector(p + 3 * k), matrix(R + 9 * k), to)) return k;
  }
  return count;
}

}  // namespace path
