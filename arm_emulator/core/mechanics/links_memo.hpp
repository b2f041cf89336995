// The links' part at the place where it was asked for last: the end of a step is the start of the
// next one.
#pragma once

#include "mechanics/links.hpp"
#include "mechanics/state.hpp"

namespace arm {

template <class S>
class LinksMemo {
 public:
  using Dynamics = typename Links<S>::Dynamics;

  // By the same instructions, whether it is known or not.
  const Dynamics& at(const Numbers<S>& n, const State<S>& x) {
    bool same = known_;
    for (int j = 0; j < S::N; ++j) same &= q_[j] == x.q[j] && v_[j] == x.v[j];
    if (same) return links_;
    for (int j = 0; j < S::N; ++j) q_[j] = x.q[j], v_[j] = x.v[j];
    Links<S>::dynamics_apart(n, x.q, x.v, links_);
    known_ = true;
    return links_;
  }
  // The numbers have changed, or may have.
  void forget() { known_ = false; }

 private:
  double q_[S::N], v_[S::N];
  Dynamics links_;
  bool known_ = false;
};

}  // namespace arm
