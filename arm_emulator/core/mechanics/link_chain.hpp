// The links: M(q) dv/dt + nle(q, v) + Dl v = T, eq. (4), by Newton-Euler recursion
// (Luh, Walker and Paul 1980; mass matrix: Walker and Orin 1982, method 3).
//
// All vectors are expressed in the links' own frames (scene.hpp). `nle` contains the Coriolis,
// centrifugal and gravity terms, called C in the paper.
#pragma once

#include "mechanics/numbers.hpp"
#include "numerics/cholesky.hpp"
#include "numerics/row.hpp"
#include "numerics/sincos.hpp"

namespace arm {

template <class S, class X = Real>
struct LinkChain {
  static constexpr int N = S::L;
  using Numbers = arm::Numbers<S, X>;

  // All that depends on q alone.
  struct Kinematics {
    Placement<X> link[N];
  };

  struct MassMatrix {
    alignas(64) Symmetric<N, X> at;
  };

  // M and nle of the links at one (q, v).
  struct Dynamics {
    alignas(64) X nle[N];
    MassMatrix M;
  };

  static ARM_INLINE constexpr bool revolute(int i) {
    return kLinks<S>.at[i].kind == JointKind::revolute;
  }

  static ARM_INLINE void kinematics(const X* q, Kinematics& k) {
    X theta[N];
    SinCos<X> turn[N];
    for_each<N>([&](auto i) __attribute__((always_inline)) {
      theta[i] = (revolute(i) ? q[i] : X{}) + kLinks<S>.at[i].theta_0;
    });
    sines(theta, turn);
    for_each<N>([&](auto i) __attribute__((always_inline)) {
      const Link& joint = kLinks<S>.at[i];
      const X d = revolute(i) ? X{} : q[i];
      k.link[i] = {turn[i].sin, turn[i].cos, joint.cos_alpha, joint.sin_alpha,
                   joint.p + d * Vec3<Real>{0.0, -joint.sin_alpha, joint.cos_alpha}};
    });
  }

  // Torques that give the accelerations `a` at (q, v): M a + nle. With `a` null: nle alone.
  static ARM_INLINE void inverse_dynamics(const Numbers& n, const Kinematics& k, const X* v,
                                          const X* a, X* tau) {
    Wrench<X> wrench[N];
    wrenches(n, k, v, a, wrench);
    for_each_reverse<N>([&](auto i)
                            __attribute__((always_inline)) { tau[i] = pass_down(k, i, wrench); });
  }

  static ARM_INLINE void mass_matrix(const Numbers& n, const Kinematics& k, MassMatrix& M) {
    Carried carried(n);
    for_each_reverse<N, kUnrollNested>(
        [&](auto i) __attribute__((always_inline)) { carried.fill_row(n, k, i, M); });
  }

  // With few joints one loop runs both recursions: the processor works on one while the other waits
  // for its last result.
  static ARM_INLINE void dynamics(const Numbers& n, const X* q, const X* v, Dynamics& links) {
    Kinematics k;
    kinematics(q, k);
    if constexpr (N > kUnrollNested) {
      inverse_dynamics(n, k, v, nullptr, links.nle);
      mass_matrix(n, k, links.M);
    } else {
      Wrench<X> wrench[N];
      wrenches(n, k, v, nullptr, wrench);
      Carried carried(n);
      for_each_reverse<N>([&](auto i) __attribute__((always_inline)) {
        links.nle[i] = pass_down(k, i, wrench);
        carried.fill_row(n, k, i, links.M);
      });
    }
  }

  // The same, not inlined, for rare calls.
  static __attribute__((noinline)) void dynamics_apart(const Numbers& n, const X* q, const X* v,
                                                       Dynamics& links) {
    dynamics(n, q, v, links);
  }

  // Torques J^T w that the external wrenches put on the joints.
  static void external_torques(const Numbers& n, const Kinematics& k, X* tau) {
    Wrench<X> wrench[N];
    BaseAxes base;
    for (int i = 0; i < N; ++i) {
      base.go_on(k.link[i]);
      wrench[i] = n.external_wrench(i).at_origin(base.x, base.y);
    }
    for (int i = N - 1; i >= 0; --i) tau[i] = pass_down(k, i, wrench);
  }

  // Kinetic energy is v^T M v / 2; this is the potential energy in the field of gravity, zero with
  // every centre of mass at the world's origin.
  static X potential_energy(const Numbers& n, const Kinematics& k) {
    Vec3<X> carried_h;
    Real m = 0.0;
    for (int i = N - 1; i >= 0; --i) {
      m += n.body(i).m;
      carried_h = k.link[i].to_parent(carried_h + n.body(i).h) + m * k.link[i].p;
    }
    return -dot(n.gravity(), carried_h + n.fixed().h);
  }

 private:
  // Wrenches of each link's own motion, without the links after it.
  static ARM_INLINE void wrenches(const Numbers& n, const Kinematics& k, const X* v, const X* a,
                                  Wrench<X> (&wrench)[N]) {
    BaseAxes base;
    Vec3<X> omega, alpha;  // of the parent link, in its frame
    // Of the parent's origin; an upward acceleration represents gravity.
    Vec3<X> acc = Vec3<X>{} - n.gravity();
    for_each<N>([&](auto i) __attribute__((always_inline)) {
      const Placement<X>& link = k.link[i];
      const X a_i = a ? a[i] : X{};
      const Vec3<X> at_joint = acc + cross(alpha, link.p) + cross(omega, cross(omega, link.p));
      omega = link.to_child(omega);
      alpha = link.to_child(alpha);
      acc = link.to_child(at_joint);
      if (revolute(i)) {
        alpha = alpha + Vec3<X>{omega.y * v[i], -omega.x * v[i], a_i};
        omega.z += v[i];
      } else {
        acc = acc + Vec3<X>{2.0 * omega.y * v[i], -2.0 * omega.x * v[i], a_i};
      }
      const auto body = n.body(i);
      wrench[i].f = body.m * acc + cross(alpha, body.h) + cross(omega, cross(omega, body.h));
      wrench[i].n = body.I * alpha + cross(omega, body.I * omega) + cross(body.h, acc);
      if constexpr (S::external_wrench) {
        base.go_on(link);
        const Wrench<X> outside = n.external_wrench(i).at_origin(base.x, base.y);
        wrench[i] = {wrench[i].f - outside.f, wrench[i].n - outside.n};
      }
    });
  }

  // Add the wrench of link i to the one before; return joint i's part of it.
  static ARM_INLINE X pass_down(const Kinematics& k, auto i, Wrench<X> (&wrench)[N]) {
    if (i > 0) wrench[before(i)] = sum(wrench[before(i)], k.link[i], wrench[i]);
    return revolute(i) ? wrench[i].n.z : wrench[i].f.z;
  }

  // Mass matrix: the inertia of all that joint j carries, moved with unit acceleration of joint j,
  // seen by every joint i <= j. The wrenches of all those j go down the chain side by side.
  struct Carried {
    using Lanes = X[kPadded<N>];
    alignas(64) Lanes fx = {}, fy = {}, fz = {}, nx = {}, ny = {}, nz = {};
    Body<X> body;

    ARM_INLINE explicit Carried(const Numbers& n)
        : body(over<X>(n.body(std::integral_constant<int, N - 1>{}))) {}

    ARM_INLINE void fill_row(const Numbers& n, const Kinematics& k, auto i, MassMatrix& M) {
      const bool turns = revolute(i);
      fx[i] = turns ? -body.h.y : X{};
      fy[i] = turns ? body.h.x : X{};
      fz[i] = turns ? X{} : body.m;
      nx[i] = turns ? body.I.xz : body.h.y;
      ny[i] = turns ? body.I.yz : -body.h.x;
      nz[i] = turns ? body.I.zz : X{};
      for_each_lane_from<N>(
          i, [&](auto j) __attribute__((always_inline)) { M.at[i][j] = turns ? nz[j] : fz[j]; });
      if (i == 0) return;
      for_each_lane_from<N>(i, [&](auto j) __attribute__((always_inline)) {
        const Wrench<X> w = sum({}, k.link[i], {{fx[j], fy[j], fz[j]}, {nx[j], ny[j], nz[j]}});
        fx[j] = w.f.x, fy[j] = w.f.y, fz[j] = w.f.z;
        nx[j] = w.n.x, ny[j] = w.n.y, nz[j] = w.n.z;
      });
      body = joined(n.body(before(i)), k.link[i], body);
    }
  };

  // Sine and cosine of each angle: of many joints in vectors; with few joints, filling the vectors
  // takes longer than they save.
  static ARM_INLINE void sines(const X (&theta)[N], SinCos<X> (&turn)[N]) {
    if constexpr (N <= kUnrollNested) {
      for_each<N>([&](auto i) __attribute__((always_inline)) { turn[i] = sincos(theta[i]); });
    } else {
      using Angles = Row<N, X>;
      alignas(64) X angle[kRow<N, X>] = {}, sin[kRow<N, X>], cos[kRow<N, X>];
      for_each<N>([&](auto i) __attribute__((always_inline)) { angle[i] = theta[i]; });
      const Angles angles = Angles::gather(angle);
      Angles s, c;
      for_each<Angles::groups>([&](auto g) __attribute__((always_inline)) {
        const auto of_group = sincos(angles.at[g]);
        s.at[g] = of_group.sin, c.at[g] = of_group.cos;
      });
      s.store(sin), c.store(cos);
      for_each<N>([&](auto i) __attribute__((always_inline)) { turn[i] = {sin[i], cos[i]}; });
    }
  }

  // The base's x and y as seen from one link after the other.
  struct BaseAxes {
    Vec3<X> x = {X{} + 1.0, X{}, X{}}, y = {X{}, X{} + 1.0, X{}};
    ARM_INLINE void go_on(const Placement<X>& link) { x = link.to_child(x), y = link.to_child(y); }
  };

  static ARM_INLINE Wrench<X> sum(const Wrench<X>& parent, const Placement<X>& link,
                                  const Wrench<X>& child) {
    const Vec3<X> f = link.to_parent(child.f);
    return {parent.f + f, parent.n + link.to_parent(child.n) + cross(link.p, f)};
  }
};

}  // namespace arm
