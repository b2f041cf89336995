// The links: M(q) dv/dt + nle(q, v) + Dl v = T, eq. (4), by Newton-Euler recursion
// (Luh, Walker and Paul 1980; mass matrix: Walker and Orin 1982, method 3) over a tree of links.
//
// All vectors are expressed in the links' own frames (scene.hpp). `nle` contains the Coriolis,
// centrifugal and gravity terms, called C in the paper.
#pragma once

#include "mechanics/numbers.hpp"
#include "numerics/cholesky.hpp"
#include "numerics/row.hpp"
#include "numerics/sincos.hpp"

namespace arm {

template <int N, class X>
struct MassMatrix {
  alignas(64) Symmetric<N, X> at;

  ARM_INLINE const X& entry(int i, int j) const { return at[i < j ? i : j][i < j ? j : i]; }
};

// M and nle of the links at one (q, v).
template <int N, class X>
struct LinkDynamics {
  alignas(64) X nle[N];
  MassMatrix<N, X> M;
};

template <class S, class X = Real>
struct LinkTree {
  static constexpr int N = S::L;
  static constexpr bool forks = kTree<S>.forks, unrolled = kTree<S>.is_unrolled();
  using Numbers = arm::Numbers<S, X>;
  using Placement = PlacementIn<S, X>;

  // All that depends on q alone.
  struct Kinematics {
    Placement link[N];
  };

  using MassMatrix = arm::MassMatrix<N, X>;
  using Dynamics = LinkDynamics<N, X>;

  static ARM_INLINE constexpr bool revolute(int i) {
    return kLinks<S>.at[i].kind == JointKind::revolute;
  }

  static ARM_INLINE void compute_kinematics([[maybe_unused]] const Numbers& n, const X* q,
                                            Kinematics& k) {
    X theta[N];
    SinCos<X> turn[N];
    for_each<N>([&](auto i) __attribute__((always_inline)) {
      theta[i] = revolute(i) ? q[i] : X{};
      if constexpr (!kPlacesVary<S>) theta[i] = theta[i] + kLinks<S>.at[i].theta_0;
    });
    compute_sines(theta, turn);
    for_each<N>([&](auto i) __attribute__((always_inline)) {
      const auto& joint = n.place(i);
      const X d = revolute(i) ? X{} : q[i];
      k.link[i] =
          Placement::make(joint, turn[i].sin, turn[i].cos, joint.p + d * Placement::axis(joint));
    });
  }

  // Torques that give the accelerations `a` at (q, v): M a + nle. With `a` null: nle alone.
  static ARM_INLINE void compute_inverse_dynamics(const Numbers& n, const Kinematics& k, const X* v,
                                                  const X* a, X* tau) {
    Wrench<X> wrench[N];
    compute_wrenches(n, k, v, a, wrench);
    for_each_reverse<N>(
        [&](auto i) __attribute__((always_inline)) { tau[i] = add_to_parent(k, i, wrench); });
  }

  static ARM_INLINE void compute_mass_matrix(const Numbers& n, const Kinematics& k, MassMatrix& M) {
    Carried carried(n);
    for_each_reverse<N, unrolled ? kUnrollLimit : kUnrollNested>(
        [&](auto i) __attribute__((always_inline)) { carried.fill_row(n, k, i, M); });
  }

  // With few joints one loop runs both recursions: the processor works on one while the other waits
  // for its last result.
  static ARM_INLINE void compute_dynamics(const Numbers& n, const X* q, const X* v,
                                          Dynamics& links) {
    Kinematics k;
    compute_kinematics(n, q, k);
    if constexpr (!unrolled) {
      compute_inverse_dynamics(n, k, v, nullptr, links.nle);
      compute_mass_matrix(n, k, links.M);
    } else {
      Wrench<X> wrench[N];
      compute_wrenches(n, k, v, nullptr, wrench);
      Carried carried(n);
      for_each_reverse<N>([&](auto i) __attribute__((always_inline)) {
        links.nle[i] = add_to_parent(k, i, wrench);
        carried.fill_row(n, k, i, links.M);
      });
    }
  }

  // Dynamics, not inlined, for rare calls.
  static __attribute__((noinline)) void compute_dynamics_apart(const Numbers& n, const X* q,
                                                               const X* v, Dynamics& links) {
    compute_dynamics(n, q, v, links);
  }

  // Torques J^T w that the external wrenches put on the joints.
  static void compute_external_torques(const Numbers& n, const Kinematics& k, X* tau) {
    Wrench<X> wrench[N];
    BaseAxes base[N];
    for (int i = 0; i < N; ++i) {
      if (const int p = kTree<S>.parent[i]; p >= 0) base[i] = base[p];
      base[i].rotate(k.link[i]);
      wrench[i] = n.external_wrench(i).at_origin(base[i].x, base[i].y);
    }
    for (int i = N - 1; i >= 0; --i) tau[i] = add_to_parent(k, i, wrench);
  }

  // Kinetic energy is v^T M v / 2; this is the potential energy in the field of gravity, zero with
  // every centre of mass at the world's origin.
  static X compute_potential_energy(const Numbers& n, const Kinematics& k) {
    Vec3<X> carried_h;
    Real m = 0.0;
    [[maybe_unused]] Vec3<X> h[forks ? N : 1], of_base;
    [[maybe_unused]] Real masses[forks ? N : 1] = {};
    for (int i = N - 1; i >= 0; --i) {
      if constexpr (forks) carried_h = h[i], m = masses[i];
      m += n.body(i).m;
      carried_h = k.link[i].to_parent(carried_h + n.body(i).h) + m * k.link[i].p;
      if constexpr (forks) {
        Vec3<X>& parent_h = on_base(i) ? of_base : h[parent(i)];
        carried_h = parent_h = parent_h + carried_h;
        if (!on_base(i)) masses[parent(i)] += m;
      }
    }
    return -dot(n.gravity(), carried_h + n.fixed().h);
  }

 private:
  // Wrenches of each link's own motion, without the links after it.
  static ARM_INLINE void compute_wrenches(const Numbers& n, const Kinematics& k, const X* v,
                                          const X* a, Wrench<X> (&wrench)[N]) {
    BaseAxes base;
    Vec3<X> omega, alpha;  // of the parent link, in its frame
    // Acceleration of the parent's origin; an upward acceleration represents gravity.
    Vec3<X> acc = Vec3<X>{} - n.gravity();
    // Motion of each link from which others than the next may continue.
    struct Motion {
      BaseAxes base;
      Vec3<X> omega, alpha, acc;
    };
    [[maybe_unused]] const Motion of_base = {base, omega, alpha, acc};
    [[maybe_unused]] Motion motions[forks ? N : 1];
    for_each<N>([&](auto i) __attribute__((always_inline)) {
      const Placement& link = k.link[i];
      if constexpr (forks) {
        const Motion& from = on_base(i) ? of_base : motions[parent(i)];
        base = from.base, omega = from.omega, alpha = from.alpha, acc = from.acc;
      }
      const X a_i = a ? a[i] : X{};
      const Vec3<X> at_joint = acc + cross(omega, cross(omega, link.p), cross(alpha, link.p));
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
      wrench[i].f = fma(body.m, acc, cross(omega, cross(omega, body.h), cross(alpha, body.h)));
      wrench[i].n = cross(body.h, acc, cross(omega, body.I * omega, body.I * alpha));
      if constexpr (S::external_wrench) {
        base.rotate(link);
        const Wrench<X> outside = n.external_wrench(i).at_origin(base.x, base.y);
        wrench[i] = {wrench[i].f - outside.f, wrench[i].n - outside.n};
      }
      if constexpr (forks) motions[i] = {base, omega, alpha, acc};
    });
  }

  // Whether the base carries link i.
  static ARM_INLINE constexpr bool on_base(auto i) {
    return forks ? kTree<S>.parent[i] < 0 : i == 0;
  }
  // The link that carries link i, or 0, as constant as i is.
  template <class Index>
  static ARM_INLINE constexpr auto parent(Index i) {
    if constexpr (!forks)
      return before(i);
    else if constexpr (std::is_same_v<Index, int>)
      return kTree<S>.parent[i] < 0 ? 0 : kTree<S>.parent[i];
    else
      return std::integral_constant<int, (kTree<S>.parent[i] < 0 ? 0 : kTree<S>.parent[i])>{};
  }

  // body(j) for the links that link i carries, and itself.
  static ARM_INLINE void for_each_carried(auto i, auto&& body) {
    if constexpr (!forks)
      for_each_lane_from<N>(i, body);
    else if constexpr (std::is_same_v<decltype(i), int>)
      for (int j = i; j < kTree<S>.end[i]; ++j) body(j);
    else
      for_each_from<kTree<S>.end[i]>(i, body);
  }

  // Add the wrench of link i to its parent's; return joint i's part of it.
  static ARM_INLINE X add_to_parent(const Kinematics& k, auto i, Wrench<X> (&wrench)[N]) {
    if (!on_base(i)) wrench[parent(i)] = sum(wrench[parent(i)], k.link[i], wrench[i]);
    return revolute(i) ? wrench[i].n.z : wrench[i].f.z;
  }

  // Mass matrix: the bodies that joint j carries move with unit acceleration of joint j. Every
  // joint i on the way to the base bears their wrench. The wrenches of all j go down side by side.
  struct Carried {
    using Lanes = X[kPadded<N>];
    alignas(64) Lanes fx = {}, fy = {}, fz = {}, nx = {}, ny = {}, nz = {};
    Body<X> body;
    Body<X> bodies[forks ? N : 1];  // of links whose branches are not all taken yet

    ARM_INLINE explicit Carried(const Numbers& n)
        : body(convert_body<X>(n.body(std::integral_constant<int, N - 1>{}))) {}

    ARM_INLINE void fill_row(const Numbers& n, const Kinematics& k, auto i, MassMatrix& M) {
      const bool rotates = revolute(i);
      if constexpr (forks) body = kTree<S>.is_leaf(i) ? convert_body<X>(n.body(i)) : bodies[i];
      fx[i] = rotates ? -body.h.y : X{};
      fy[i] = rotates ? body.h.x : X{};
      fz[i] = rotates ? X{} : body.m;
      nx[i] = rotates ? body.I.xz : body.h.y;
      ny[i] = rotates ? body.I.yz : -body.h.x;
      nz[i] = rotates ? body.I.zz : X{};
      for_each_carried(
          i, [&](auto j) __attribute__((always_inline)) { M.at[i][j] = rotates ? nz[j] : fz[j]; });
      if constexpr (forks)
        for (int j = kTree<S>.end[i]; j < N; ++j) M.at[i][j] = X{};
      if (on_base(i)) return;
      for_each_carried(i, [&](auto j) __attribute__((always_inline)) {
        const Wrench<X> w = sum({}, k.link[i], {{fx[j], fy[j], fz[j]}, {nx[j], ny[j], nz[j]}});
        fx[j] = w.f.x, fy[j] = w.f.y, fz[j] = w.f.z;
        nx[j] = w.n.x, ny[j] = w.n.y, nz[j] = w.n.z;
      });
      const auto p = parent(i);
      if constexpr (!forks)
        body = join_bodies(n.body(p), k.link[i], body);
      else if (kTree<S>.is_last_child(i))
        bodies[p] = join_bodies(n.body(p), k.link[i], body);
      else
        bodies[p] = join_bodies(bodies[p], k.link[i], body);
    }
  };

  // Sine and cosine of each angle: of many joints in vectors; with few joints, filling the vectors
  // takes longer than they save.
  static ARM_INLINE void compute_sines(const X (&theta)[N], SinCos<X> (&turn)[N]) {
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
    ARM_INLINE void rotate(const Placement& link) { x = link.to_child(x), y = link.to_child(y); }
  };

  static ARM_INLINE Wrench<X> sum(const Wrench<X>& parent, const Placement& link,
                                  const Wrench<X>& child) {
    const Vec3<X> f = link.to_parent(child.f);
    return {parent.f + f, link.to_parent(child.n, cross(link.p, f, parent.n))};
  }
};

}  // namespace arm
