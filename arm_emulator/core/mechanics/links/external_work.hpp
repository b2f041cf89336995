// Work of the external wrenches of a machine [J], for the account of its energy (energy.hpp): the
// mean J^T w of both ends of a stretch times the displacement. It needs no evaluation at each step.
#pragma once

#include "mechanics/links/links.hpp"
#include "mechanics/state.hpp"

namespace arm {

template <class S>
class ExternalWork {
 public:
  static constexpr int N = S::N;

  void reset(const State<S>& x) {
    if constexpr (S::external_wrench)
      for (int j = 0; j < N; ++j) q_[j] = x.q[j];
  }

  // From the state before, or the reset, to x.
  Real add_since(const Numbers<S>& n, const State<S>& x) {
    Real there[N], here[N], work = 0.0;
    compute_torques(n, q_, there);
    compute_torques(n, x.q, here);
    for (int j = 0; j < N; ++j) work += 0.5 * (there[j] + here[j]) * (x.q[j] - q_[j]);
    reset(x);
    return work;
  }

  // number(x) for everything that it remembers, in a fixed order.
  template <class Number>
  void for_each_number(Number&& number) {
    if constexpr (S::external_wrench)
      for (Real& one : q_) number(one);
  }

 private:
  static void compute_torques(const Numbers<S>& n, const Real* q, Real* tau) {
    typename Links<S>::Kinematics kinematics;
    Links<S>::compute_kinematics(n, q, kinematics);
    Links<S>::compute_external_torques(n, kinematics, tau);
  }

  Real q_[S::external_wrench ? N : 1] = {};
};

}  // namespace arm
