// Kinematics and inverse dynamics of a tree of joints, all vectors along the world's axes.
#pragma once

#include <array>
#include <cmath>

#include "numerics/sincos.hpp"
#include "path.h"

namespace path {

constexpr int MAX_JOINTS = 128;

using Vector = std::array<double, 3>;
using Matrix = std::array<double, 9>;  // row by row

inline Vector operator+(const Vector& a, const Vector& b) {
  return {a[0] + b[0], a[1] + b[1], a[2] + b[2]};
}
inline Vector operator-(const Vector& a, const Vector& b) {
  return {a[0] - b[0], a[1] - b[1], a[2] - b[2]};
}
inline Vector operator*(double s, const Vector& a) { return {s * a[0], s * a[1], s * a[2]}; }
inline double dot(const Vector& a, const Vector& b) {
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}
inline Vector cross(const Vector& a, const Vector& b) {
  return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
}
inline Vector operator*(const Matrix& R, const Vector& a) {
  return {R[0] * a[0] + R[1] * a[1] + R[2] * a[2], R[3] * a[0] + R[4] * a[1] + R[5] * a[2],
          R[6] * a[0] + R[7] * a[1] + R[8] * a[2]};
}
inline Vector transposed_times(const Matrix& R, const Vector& a) {
  return {R[0] * a[0] + R[3] * a[1] + R[6] * a[2], R[1] * a[0] + R[4] * a[1] + R[7] * a[2],
          R[2] * a[0] + R[5] * a[1] + R[8] * a[2]};
}
inline Matrix operator*(const Matrix& A, const Matrix& B) {
  Matrix C;
  for (int i = 0; i < 3; ++i)
    for (int k = 0; k < 3; ++k)
      C[3 * i + k] = A[3 * i] * B[k] + A[3 * i + 1] * B[3 + k] + A[3 * i + 2] * B[6 + k];
  return C;
}
inline Vector vector(const double* a) { return {a[0], a[1], a[2]}; }
inline Matrix matrix(const double* a) {
  return {a[0], a[1], a[2], a[3], a[4], a[5], a[6], a[7], a[8]};
}

// Rotation by an angle about a unit vector (Rodrigues).
inline Matrix turn(const Vector& u, double angle) {
  const auto [s, c] = arm::sincos(angle);
  const double d = 1.0 - c;
  return {c + d * u[0] * u[0],        d * u[0] * u[1] - s * u[2], d * u[0] * u[2] + s * u[1],
          d * u[0] * u[1] + s * u[2], c + d * u[1] * u[1],        d * u[1] * u[2] - s * u[0],
          d * u[0] * u[2] - s * u[1], d * u[1] * u[2] + s * u[0], c + d * u[2] * u[2]};
}

// Rotation vector of a rotation, its length in [0, pi].
inline Vector rotation_vector(const Matrix& R) {
  const Vector w = {R[7] - R[5], R[2] - R[6], R[3] - R[1]};  // 2 sin(angle) u
  const double sine = 0.5 * std::sqrt(dot(w, w)), cosine = 0.5 * (R[0] + R[4] + R[8] - 1.0);
  const double angle = std::atan2(sine, cosine);
  if (sine > 1e-3 || cosine > 0.0) return (sine > 1e-12 ? 0.5 * angle / sine : 0.5) * w;
  // Near half a turn u is the longest column of R + 1, of the sign that w has.
  int k = 0;
  for (int i = 1; i < 3; ++i)
    if (R[4 * i] > R[4 * k]) k = i;
  Vector u = {R[k], R[3 + k], R[6 + k]};
  u[k] += 1.0;
  const double length = std::sqrt(dot(u, u)) * (dot(u, w) < 0.0 ? -1.0 : 1.0);
  return (angle / length) * u;
}

struct Frames {
  Matrix R[MAX_JOINTS];
  Vector p[MAX_JOINTS], axis[MAX_JOINTS];
  Matrix R_tool;
  Vector p_tool;

  Frames(const path_arm& arm, const double* q) {
    for (int i = 0; i < arm.joints; ++i) {
      const int parent = arm.parent[i];
      const Matrix own = matrix(arm.rotation + 9 * i);
      const Vector at = vector(arm.place + 3 * i);
      R[i] = parent < 0 ? own : R[parent] * own;
      p[i] = parent < 0 ? at : p[parent] + R[parent] * at;
      const Vector u = vector(arm.axis + 3 * i);
      axis[i] = R[i] * u;
      if (arm.slides[i])
        p[i] = p[i] + q[i] * axis[i];
      else
        R[i] = R[i] * turn(u, q[i]);
    }
    const int parent = arm.tool_parent;
    const Matrix own = matrix(arm.tool_rotation);
    const Vector at = vector(arm.tool_place);
    R_tool = parent < 0 ? own : R[parent] * own;
    p_tool = parent < 0 ? at : p[parent] + R[parent] * at;
  }
};

inline void torques(const path_arm& arm, const Frames& at, const double* v, const double* a,
                    double* tau) {
  Vector omega[MAX_JOINTS], alpha[MAX_JOINTS], acc[MAX_JOINTS], f[MAX_JOINTS], n[MAX_JOINTS];
  for (int i = 0; i < arm.joints; ++i) {
    const int k = arm.parent[i];
    const Vector none = {0.0, 0.0, 0.0}, &z = at.axis[i];
    const Vector w = k < 0 ? none : omega[k], dw = k < 0 ? none : alpha[k];
    const Vector r = k < 0 ? at.p[i] : at.p[i] - at.p[k];
    const Vector base = k < 0 ? -1.0 * vector(arm.gravity) : acc[k];
    omega[i] = w, alpha[i] = dw;
    acc[i] = base + cross(dw, r) + cross(w, cross(w, r));
    if (arm.slides[i]) {
      acc[i] = acc[i] + a[i] * z + (2.0 * v[i]) * cross(w, z);
    } else {
      omega[i] = w + v[i] * z;
      alpha[i] = dw + a[i] * z + v[i] * cross(w, z);
    }
    const Vector c = at.R[i] * vector(arm.centre + 3 * i);
    const Matrix I = matrix(arm.inertia + 9 * i);
    const Vector acc_c = acc[i] + cross(alpha[i], c) + cross(omega[i], cross(omega[i], c));
    f[i] = arm.mass[i] * acc_c;
    const Vector spin = at.R[i] * (I * transposed_times(at.R[i], omega[i]));
    n[i] = at.R[i] * (I * transposed_times(at.R[i], alpha[i])) + cross(omega[i], spin) +
           cross(c, f[i]);
  }
  for (int i = arm.joints - 1; i >= 0; --i) {
    tau[i] = dot(at.axis[i], arm.slides[i] ? f[i] : n[i]);
    const int k = arm.parent[i];
    if (k < 0) continue;
    f[k] = f[k] + f[i];
    n[k] = n[k] + n[i] + cross(at.p[i] - at.p[k], f[i]);
  }
}

}  // namespace path
