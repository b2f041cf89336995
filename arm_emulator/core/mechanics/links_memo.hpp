// Cache of the links' part at the last states: the end of a step is the start of the next.
#pragma once

#include "mechanics/links.hpp"
#include "mechanics/state.hpp"

namespace arm {

// `kept`: how many states it knows.
template <class S, class X = Real, int kept = 1>
class LinksMemo {
 public:
  using Dynamics = typename Links<S, X>::Dynamics;

  // The same instructions whether cached or not. A reference lasts until `kept` others are made.
  const Dynamics& at(const Numbers<S, X>& n, const State<S, X>& x) {
    for (const Entry& one : of_)
      if (one.is_of(x)) return one.links;
    newest_ = (newest_ + 1) % kept;
    Entry& one = of_[newest_];
    for (int j = 0; j < S::N; ++j) one.q[j] = x.q[j], one.v[j] = x.v[j];
    Links<S, X>::dynamics_apart(n, x.q, x.v, one.links);
    one.known = true;
    return one.links;
  }
  // The newest ones, to be changed.
  Dynamics& used_up() {
    of_[newest_].known = false;
    return of_[newest_].links;
  }
  // The numbers have changed, or may have.
  void forget() {
    for (Entry& one : of_) one.known = false;
  }

 private:
  struct Entry {
    X q[S::N], v[S::N];
    Dynamics links;
    bool known = false;

    bool is_of(const State<S, X>& x) const {
      Mask<X> same = where(known, X{} == X{});
      for (int j = 0; j < S::N; ++j) same &= (q[j] == x.q[j]) & (v[j] == x.v[j]);
      return all(same);
    }
  };

  Entry of_[kept];
  int newest_ = 0;
};

}  // namespace arm
