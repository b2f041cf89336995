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
    bool same = known;
    for (int j = 0; j < S::N; ++j) same &= q[j] == x.q[j] && v[j] == x.v[j];
    if (same) return links;
    for (int j = 0; j < S::N; ++j) q[j] = x.q[j], v[j] = x.v[j];
    Links<S>::dynamics_apart(n, x.q, x.v, links);
    known = true;
    return links;
  }
  // The numbers have changed, or may have.
  void forget() { known = false; }

 private:
  double q[S::N], v[S::N];
  Dynamics links;
  bool known = false;
};

}  // namespace arm
