// The links: M(q) dv/dt + nle(q, v) + Dl v = T, eq. (4), by Newton-Euler recursion
// (Luh, Walker and Paul 1980; mass matrix: Walker and Orin 1982, method 3).
//
// Everything is expressed in the links' own frames (scene.hpp). `nle` holds the Coriolis,
// centrifugal and gravity terms, which the paper calls C.
#pragma once

#include "cholesky.hpp"
#include "scene.hpp"
#include "sincos.hpp"

namespace arm {

// A link's frame in its parent's, at one q. Vectors go up and down the chain through it.
struct Placement {
  double sin, cos;              // of the turn about z
  double cos_alpha, sin_alpha;  // of the fixed turn about x
  Vec3 p;                       // origin, in the parent's frame

  ARM_INLINE Vec3 to_child(Vec3 u) const {
    const double y = cos_alpha * u.y + sin_alpha * u.z;
    return {cos * u.x + sin * y, cos * y - sin * u.x, cos_alpha * u.z - sin_alpha * u.y};
  }
  ARM_INLINE Vec3 to_parent(Vec3 u) const {
    const double y = sin * u.x + cos * u.y;
    return {cos * u.x - sin * u.y, cos_alpha * y - sin_alpha * u.z,
            sin_alpha * y + cos_alpha * u.z};
  }
  // The tensor R a R^T of the parent's frame.
  ARM_INLINE Sym3 to_parent(Sym3 a) const {
    const double cc = cos * cos, ss = sin * sin, cs = cos * sin;
    const double xx = cc * a.xx + ss * a.yy - 2.0 * cs * a.xy;
    const double yy = ss * a.xx + cc * a.yy + 2.0 * cs * a.xy;
    const double xy = cs * (a.xx - a.yy) + (cc - ss) * a.xy;
    const double xz = cos * a.xz - sin * a.yz;
    const double yz = sin * a.xz + cos * a.yz;
    const double ca = cos_alpha, sa = sin_alpha;
    return {xx,
            ca * ca * yy + sa * sa * a.zz - 2.0 * ca * sa * yz,
            sa * sa * yy + ca * ca * a.zz + 2.0 * ca * sa * yz,
            ca * xy - sa * xz,
            sa * xy + ca * xz,
            ca * sa * (yy - a.zz) + (ca * ca - sa * sa) * yz};
  }
};

// Force and moment about a frame's origin.
struct Wrench {
  Vec3 f, n;
};

template <class S>
struct Links {
  static constexpr int N = S::N;

  // All that depends on q alone.
  struct Kinematics {
    Placement link[N];
  };

  struct MassMatrix {
    Symmetric<N> at;
  };

  // All that the equation of motion takes from the links at one (q, v).
  struct Dynamics {
    double nle[N];
    MassMatrix M;
  };

  static ARM_INLINE constexpr bool revolute(int i) {
    return S::joint[i].kind == JointKind::revolute;
  }

  static ARM_INLINE void kinematics(const double (&q)[N], Kinematics& k) {
    for_each<N>([&](auto i) __attribute__((always_inline)) {
      const Joint& joint = S::joint[i];
      const double theta = revolute(i) ? joint.theta_0 + q[i] : joint.theta_0;
      const auto [sin, cos] = sincos(theta);
      const double d = revolute(i) ? 0.0 : q[i];
      k.link[i] = {sin, cos, joint.cos_alpha, joint.sin_alpha,
                   joint.p + d * Vec3{0.0, -joint.sin_alpha, joint.cos_alpha}};
    });
  }

  // Torques that give the accelerations `a` at (q, v): M a + nle. With `a` null: nle alone.
  static ARM_INLINE void inverse_dynamics(const Kinematics& k, const double (&v)[N],
                                          const double* a, double (&tau)[N]) {
    Wrench wrench[N];
    Vec3 omega{}, alpha{};   // of the parent link, in its frame
    Vec3 acc = -S::gravity;  // of the parent's origin; accelerating upwards stands for gravity
    for_each<N>([&](auto i) __attribute__((always_inline)) {
      const Placement& link = k.link[i];
      const double a_i = a ? a[i] : 0.0;
      const Vec3 at_joint = acc + cross(alpha, link.p) + cross(omega, cross(omega, link.p));
      omega = link.to_child(omega);
      alpha = link.to_child(alpha);
      acc = link.to_child(at_joint);
      if (revolute(i)) {
        alpha = alpha + Vec3{omega.y * v[i], -omega.x * v[i], a_i};
        omega.z += v[i];
      } else {
        acc = acc + Vec3{2.0 * omega.y * v[i], -2.0 * omega.x * v[i], a_i};
      }
      const Body& body = S::joint[i].body;
      wrench[i].f = body.m * acc + cross(alpha, body.h) + cross(omega, cross(omega, body.h));
      wrench[i].n = body.I * alpha + cross(omega, body.I * omega) + cross(body.h, acc);
    });
    for_each_reverse<N>([&](auto i) __attribute__((always_inline)) {
      tau[i] = revolute(i) ? wrench[i].n.z : wrench[i].f.z;
      if (i > 0) wrench[i - 1] = sum(wrench[i - 1], k.link[i], wrench[i]);
    });
  }

  // Mass matrix: the inertia of all that joint j carries, moved with unit acceleration of joint j,
  // seen by every joint i <= j. The wrenches of all those j go down the chain side by side.
  static ARM_INLINE void mass_matrix(const Kinematics& k, MassMatrix& M) {
    constexpr int n = kPadded<N>;
    double fx[n] = {}, fy[n] = {}, fz[n] = {}, nx[n] = {}, ny[n] = {}, nz[n] = {};
    Body carried = S::joint[N - 1].body;
    for_each_reverse<N, kUnrollNested>([&](auto i) __attribute__((always_inline)) {
      const bool turns = revolute(i);
      fx[i] = turns ? -carried.h.y : 0.0;
      fy[i] = turns ? carried.h.x : 0.0;
      fz[i] = turns ? 0.0 : carried.m;
      nx[i] = turns ? carried.I.xz : carried.h.y;
      ny[i] = turns ? carried.I.yz : -carried.h.x;
      nz[i] = turns ? carried.I.zz : 0.0;
      for_each_lane_from<N>(
          i, [&](auto j) __attribute__((always_inline)) { M.at[i][j] = turns ? nz[j] : fz[j]; });
      if (i == 0) return;
      for_each_lane_from<N>(i, [&](auto j) __attribute__((always_inline)) {
        const Wrench w = sum({}, k.link[i], {{fx[j], fy[j], fz[j]}, {nx[j], ny[j], nz[j]}});
        fx[j] = w.f.x, fy[j] = w.f.y, fz[j] = w.f.z;
        nx[j] = w.n.x, ny[j] = w.n.y, nz[j] = w.n.z;
      });
      carried = sum(S::joint[i > 0 ? i - 1 : 0].body, k.link[i], carried);
    });
  }

  static ARM_INLINE void dynamics(const double (&q)[N], const double (&v)[N], Dynamics& links) {
    Kinematics k;
    kinematics(q, k);
    inverse_dynamics(k, v, nullptr, links.nle);
    mass_matrix(k, links.M);
  }

  // Kinetic energy is v^T M v / 2; this is the potential energy in the field S::gravity, zero with
  // every centre of mass at the world's origin.
  static double potential_energy(const Kinematics& k) {
    Vec3 carried_h{};
    double m = 0.0;
    for (int i = N - 1; i >= 0; --i) {
      m += S::joint[i].body.m;
      carried_h = k.link[i].to_parent(carried_h + S::joint[i].body.h) + m * k.link[i].p;
    }
    return -dot(S::gravity, carried_h);
  }

 private:
  static ARM_INLINE Wrench sum(Wrench parent, const Placement& link, Wrench child) {
    const Vec3 f = link.to_parent(child.f);
    return {parent.f + f, parent.n + link.to_parent(child.n) + cross(link.p, f)};
  }

  // Parallel-axis theorem with first moments: h and I about the parent's origin.
  static ARM_INLINE Body sum(const Body& parent, const Placement& link, const Body& child) {
    const Vec3 h = link.to_parent(child.h);
    const Vec3 p = link.p;
    const Vec3 mp = child.m * p;
    const double trace = 2.0 * dot(h, p) + dot(mp, p);
    const Sym3 shift = {trace - 2.0 * h.x * p.x - mp.x * p.x, trace - 2.0 * h.y * p.y - mp.y * p.y,
                        trace - 2.0 * h.z * p.z - mp.z * p.z, -h.x * p.y - h.y * p.x - mp.x * p.y,
                        -h.x * p.z - h.z * p.x - mp.x * p.z,  -h.y * p.z - h.z * p.y - mp.y * p.z};
    return {parent.m + child.m, parent.h + h + mp, parent.I + link.to_parent(child.I) + shift};
  }
};

}  // namespace arm
