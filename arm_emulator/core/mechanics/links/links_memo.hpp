// Cache of the links' part at the last state: the end of a step is the start of the next.
#pragma once

#include "mechanics/links/links.hpp"
#include "mechanics/state.hpp"

namespace arm {

template <class S, class X = Real>
class LinksMemo {
 public:
  using Dynamics = typename Links<S, X>::Dynamics;

  // The result of the same instructions, whether it is cached or not.
  const Dynamics& at(const Numbers<S, X>& n, const State<S, X>& x) {
    Mask<X> same = where(is_valid_, X{} == X{});
    for (int j = 0; j < S::N; ++j) same &= (q_[j] == x.q[j]) & (v_[j] == x.v[j]);
    if (all(same)) return links_;
    for (int j = 0; j < S::N; ++j) q_[j] = x.q[j], v_[j] = x.v[j];
    Links<S, X>::dynamics_apart(n, x.q, x.v, links_);
    is_valid_ = true;
    return links_;
  }
  // The newest ones, to be changed.
  Dynamics& used_up() {
    is_valid_ = false;
    return links_;
  }
  // The numbers have changed, or may have.
  void forget() { is_valid_ = false; }

 private:
  X q_[S::N], v_[S::N];
  Dynamics links_;
  bool is_valid_ = false;
};

}  // namespace arm
