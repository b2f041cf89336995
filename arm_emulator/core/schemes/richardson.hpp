// Richardson's extrapolation of `rosenbrock`: third order where motions are smooth.
//
//   w: a step h of ROS2 from x        y: two steps h/2        x' = y + (y - w) / 3
//
// The error of a step is c h^3 + O(h^4) for w, with any A (Verwer et al. 1999), and a quarter of
// that for y: the combination has none of order h^3. Where modes of drives change, or a link stops,
// both have errors that do not scale so, and x' = y.
#pragma once

#include "mechanics/regular_mode.hpp"
#include "schemes/linearly_implicit.hpp"
#include "schemes/scheme.hpp"

namespace arm {

template <class S, class X = Real>
class RichardsonScheme {
 public:
  static constexpr int N = S::N, K = most_states<S>();
  using Steps = LinearlyImplicit<S, X>;
  using Dynamics = typename Steps::Dynamics;
  static constexpr int row = Steps::row;

  RichardsonScheme(Real step, const Numbers<S, X>& numbers)
      : n_(numbers), whole_(step, numbers), half_(0.5 * step, numbers) {}

  // The numbers of a lane have changed, or all.
  void renew(int lane) { whole_.renew(lane), half_.renew(lane); }
  void renew() { whole_.renew(), half_.renew(); }

  // It has no past.
  struct Memory {
    template <class Number>
    void for_each_number(Number&&) {}
  };
  void reset(const State<S, X>&) {}
  Memory memory() const { return {}; }
  Memory memory_before() const { return {}; }
  void restore(Memory) {}

  template <class Exchange>
  ARM_INLINE void step(State<S, X>& x, const X (&u)[row], Dynamics& links, Exchange& exchange) {
    exchange.take(links);
    State<S, X> w = x;
    Dynamics at_start = links, at_half;
    take(whole_, w, u, at_start);
    take(half_, x, u, links);
    Links<S, X>::dynamics_apart(n_, x.q, x.v, at_half);
    take(half_, x, u, at_half);
    combine(w, u, x);
    exchange.give(x);
  }

 private:
  ARM_APART static void take(Steps& steps, State<S, X>& x, const X (&u)[row], Dynamics& links) {
    NullExchange nobody;
    steps.step(x, u, links, nobody);
  }

  // From y to y + (y - w) / 3, where both are smooth.
  ARM_INLINE void combine(const State<S, X>& w, const X (&u)[row], State<S, X>& y) const {
    Mask<X> smooth = is_usual(n_, w, u) & is_usual(n_, y, u);
    if constexpr (Coulomb<S, X>::present)
      for_each<N>([&](auto j) __attribute__((always_inline)) {
        smooth &= (w.v[j] == 0.0) == (y.v[j] == 0.0);
      });
    const auto better = [&](X& of_y, const X& of_w) __attribute__((always_inline)) {
      of_y = select(smooth, fma(1.0 / 3.0, of_y - of_w, of_y), of_y);
    };
    for_each<N>([&](auto j) __attribute__((always_inline)) {
      for_each<K, kMostStates>(
          [&](auto k) __attribute__((always_inline)) { better(y.z[k][j], w.z[k][j]); });
      better(y.q[j], w.q[j]), better(y.v[j], w.v[j]);
    });
  }

  const Numbers<S, X>& n_;
  Steps whole_, half_;
};

struct Richardson : AnyScheme {
  static constexpr int stages = 2;
  template <class S, class X>
  using Method = RichardsonScheme<S, X>;
};

}  // namespace arm
