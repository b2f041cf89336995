// Links with joints coupled to several drives, or drives to several joints: mimic joints of a
// telescope, fingers of a gripper, parallelograms, bevel wrists, differentials. With p the angles
// of the drives' shafts, behind their gears,
//
//   q = C p + q_0        C: constant, a row per joint, a column per shaft
//
// Since C is constant, the equation of motion in p is
//
//   C^T M(q) C dp'/dt + C^T nle(q, C p') = T
//
// Rotors, gears, friction, brakes, stops and encoders belong to a drive, and so to p.
#pragma once

#include "mechanics/links/link_tree.hpp"

namespace arm {

template <class S, class X>
struct CoupledLinks {
  static constexpr int N = S::N, L = S::L;
  using Tree = LinkTree<S, X>;
  using Numbers = arm::Numbers<S, X>;
  using Kinematics = typename Tree::Kinematics;

  using MassMatrix = arm::MassMatrix<N, X>;
  using Dynamics = LinkDynamics<N, X>;

  static ARM_INLINE void compute_kinematics(const Numbers& n, const X* p, Kinematics& k) {
    X q[L];
    map_to_joints(p, q);
    for_each<L>([&](auto i)
                    __attribute__((always_inline)) { q[i] = q[i] + S::coupling_offset[i]; });
    Tree::compute_kinematics(n, q, k);
  }

  static ARM_INLINE void compute_inverse_dynamics(const Numbers& n, const Kinematics& k, const X* v,
                                                  const X* a, X* tau) {
    X joint_v[L], joint_a[L], joint_tau[L];
    map_to_joints(v, joint_v);
    if (a) map_to_joints(a, joint_a);
    Tree::compute_inverse_dynamics(n, k, joint_v, a ? joint_a : nullptr, joint_tau);
    map_to_shafts(joint_tau, tau);
  }

  static ARM_INLINE void compute_mass_matrix(const Numbers& n, const Kinematics& k, MassMatrix& M) {
    typename Tree::MassMatrix of_joints;
    Tree::compute_mass_matrix(n, k, of_joints);
    project(of_joints, M);
  }

  static ARM_INLINE void compute_dynamics(const Numbers& n, const X* p, const X* v,
                                          Dynamics& links) {
    Kinematics k;
    compute_kinematics(n, p, k);
    compute_inverse_dynamics(n, k, v, nullptr, links.nle);
    compute_mass_matrix(n, k, links.M);
  }
  static __attribute__((noinline)) void compute_dynamics_apart(const Numbers& n, const X* p,
                                                               const X* v, Dynamics& links) {
    compute_dynamics(n, p, v, links);
  }

  static void compute_external_torques(const Numbers& n, const Kinematics& k, X* tau) {
    X joint_tau[L];
    Tree::compute_external_torques(n, k, joint_tau);
    map_to_shafts(joint_tau, tau);
  }
  static X compute_potential_energy(const Numbers& n, const Kinematics& k) {
    return Tree::compute_potential_energy(n, k);
  }

  // C x: speeds or accelerations of the joints from those of the shafts.
  static ARM_INLINE void map_to_joints(const X* of_shafts, X* of_joints) {
    for_each<L>([&](auto i) __attribute__((always_inline)) {
      of_joints[i] = X{};
      for_each<N>([&](auto j) __attribute__((always_inline)) {
        if (S::coupling[i][j] != 0.0)
          of_joints[i] = of_joints[i] + S::coupling[i][j] * of_shafts[j];
      });
    });
  }

 private:
  // C^T x: torques at the shafts from those at the joints.
  static ARM_INLINE void map_to_shafts(const X* of_joints, X* of_shafts) {
    for_each<N>([&](auto j) __attribute__((always_inline)) {
      of_shafts[j] = X{};
      for_each<L>([&](auto i) __attribute__((always_inline)) {
        if (S::coupling[i][j] != 0.0)
          of_shafts[j] = of_shafts[j] + S::coupling[i][j] * of_joints[i];
      });
    });
  }

  // C^T M C, column by column.
  static ARM_INLINE void project(const typename Tree::MassMatrix& of_joints, MassMatrix& M) {
    for_each<N, kUnrollNested>([&](auto j) __attribute__((always_inline)) {
      X column[L], seen[N];
      for_each<L>([&](auto i) __attribute__((always_inline)) {
        column[i] = X{};
        for_each<L>([&](auto k) __attribute__((always_inline)) {
          if (S::coupling[k][j] != 0.0 && kTree<S>.is_related(i, k))
            column[i] = column[i] + S::coupling[k][j] * of_joints.entry(i, k);
        });
      });
      map_to_shafts(column, seen);
      for_each<N>([&](auto i) __attribute__((always_inline)) {
        if (i <= j) M.at[i][j] = seen[i];
      });
    });
  }
};

// The links as the drives see them: the tree itself, where each drive moves a joint of its own.
template <class S, class X = Real>
using Links = std::conditional_t<kCoupled<S>, CoupledLinks<S, X>, LinkTree<S, X>>;

// Torques M a + nle of the links, not inlined, for rare calls.
template <class S, class X>
ARM_APART void compute_inverse_dynamics_apart(const Numbers<S, X>& n, const X* q, const X* v,
                                              const X* a, X* torque) {
  typename Links<S, X>::Kinematics kinematics;
  Links<S, X>::compute_kinematics(n, q, kinematics);
  Links<S, X>::compute_inverse_dynamics(n, kinematics, v, a, torque);
}

// Torques of the links, and of the rotors that turn with them, for the accelerations `a`.
template <class S, class X>
void compute_link_torques(const Numbers<S, X>& n, const X* q, const X* v, const X* a, X* torque) {
  compute_inverse_dynamics_apart<S>(n, q, v, a, torque);
  for (int j = 0; j < S::N; ++j) torque[j] += n.carried(j) * a[j];
}

}  // namespace arm
