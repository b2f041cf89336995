// Coulomb friction at the links, and the equations of motion solved with it.
//
// A sliding joint feels -Dc sign(v). A joint at rest is locked while the torque that holds it is at
// most its breakaway torque Ds >= Dc; else it starts to slide that way. A joint whose speed would
// change sign within a step comes to rest at the step's end. So a joint at rest stays at rest
// exactly, without regularisation and at any step size; where a joint stops or starts, the instant
// is known to one step only, and the scheme's order there is 1.
#pragma once

#include "cholesky.hpp"
#include "scene.hpp"

namespace arm {

template <class S>
class Friction {
 public:
  static constexpr int N = S::N;

  static constexpr bool present() {
    for (const Joint& joint : S::joint)
      if (joint.Dc > 0.0) return true;
    return false;
  }

  // Decide what each joint does in this step, for W x = rhs, and solve for x. The factors and the
  // decisions serve `solve_again` for a second right-hand side of the same step.
  ARM_INLINE void solve(Symmetric<N>& W, const double (&v)[N], double (&x)[N]) {
    if constexpr (!present()) {
      factors.factor(W);
      factors.solve(x);
    } else {
      for (int j = 0; j < N; ++j) {
        direction[j] = v[j] > 0.0 ? 1.0 : v[j] < 0.0 ? -1.0 : 0.0;
        locked[j] = S::joint[j].Dc > 0.0 && v[j] == 0.0;
      }
      double rhs[N];
      for (int j = 0; j < N; ++j) rhs[j] = x[j];
      // Each round frees one joint, so there are at most N.
      do {
        factor_unlocked(W);
        for (int j = 0; j < N; ++j) x[j] = rhs[j] - S::joint[j].Dc * direction[j];
        solve_again(x);
      } while (free_one(W, rhs, x));
    }
  }

  ARM_INLINE void solve_again(double (&x)[N]) const {
    if constexpr (present())
      for (int j = 0; j < N; ++j) x[j] = locked[j] ? 0.0 : x[j];
    factors.solve(x);
  }

  // Torque against the motion of joint j, or of the lock that holds it.
  ARM_INLINE double force(int j) const {
    if constexpr (present())
      return locked[j] ? held[j] : S::joint[j].Dc * direction[j];
    else
      return 0.0;
  }

  // Joints whose speed has changed sign come to rest.
  ARM_INLINE void stop_at_reversal(double (&v)[N]) const {
    if constexpr (present())
      for (int j = 0; j < N; ++j)
        if (S::joint[j].Dc > 0.0 && v[j] * direction[j] <= 0.0) v[j] = 0.0;
  }

 private:
  // M with the rows and columns of the locked joints made those of the identity.
  void factor_unlocked(const Symmetric<N>& W) {
    Symmetric<N> free = {};
    for (int j = 0; j < N; ++j)
      for (int k = j; k < N; ++k)
        free[j][k] = !locked[j] && !locked[k] ? W[j][k] : j == k ? 1.0 : 0.0;
    factors.factor(free);
  }

  // Free the joint that is the most overloaded; false if every locked joint holds.
  bool free_one(const Symmetric<N>& W, const double (&rhs)[N], const double (&x)[N]) {
    int worst = -1;
    double excess = 0.0, way = 0.0;
    for (int j = 0; j < N; ++j) {
      if (!locked[j]) continue;
      double torque = rhs[j];
      for (int k = 0; k < N; ++k) torque -= (k >= j ? W[j][k] : W[k][j]) * x[k];
      held[j] = torque;
      const double size = torque < 0.0 ? -torque : torque;
      if (size - S::joint[j].Ds > excess) {
        worst = j;
        excess = size - S::joint[j].Ds;
        way = torque < 0.0 ? -1.0 : 1.0;
      }
    }
    if (worst < 0) return false;
    locked[worst] = false;
    direction[worst] = way;
    return true;
  }

  Cholesky<N> factors;
  bool locked[N] = {};
  double direction[N] = {};
  double held[N] = {};  // torque of a lock [N m]
};

}  // namespace arm
