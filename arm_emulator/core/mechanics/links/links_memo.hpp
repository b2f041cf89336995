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
  ARM_INLINE const Dynamics& find_at(const Numbers<S, X>& n, const State<S, X>& x) {
    if (is_valid_ && is_at(x)) return links_;
    return compute(n, x);
  }
  // The newest ones, to be changed.
  Dynamics& release_links() {
    is_valid_ = false;
    return links_;
  }
  // The numbers have changed, or may have.
  void invalidate() { is_valid_ = false; }

 private:
  using Row = arm::Row<S::N, X>;

  ARM_INLINE bool is_at(const State<S, X>& x) const {
    const Row q = Row::load(x.q), v = Row::load(x.v), q_here = Row::load(q_),
              v_here = Row::load(v_);
    auto same = typename Row::Vector{} == typename Row::Vector{};
    for (int g = 0; g < Row::groups; ++g)
      same &= (q.at[g] == q_here.at[g]) & (v.at[g] == v_here.at[g]);
    return all(same);
  }
  ARM_APART const Dynamics& compute(const Numbers<S, X>& n, const State<S, X>& x) {
    Row::load(x.q).store(q_), Row::load(x.v).store(v_);
    Links<S, X>::compute_dynamics_apart(n, x.q, x.v, links_);
    is_valid_ = true;
    return links_;
  }

  alignas(64) X q_[State<S, X>::row] = {}, v_[State<S, X>::row] = {};
  Dynamics links_;
  bool is_valid_ = false;
};

}  // namespace arm
