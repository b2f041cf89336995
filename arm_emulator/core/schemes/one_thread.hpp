// Motors and links in the calling thread: the sequential reference, and faster where the links take
// less time than an exchange between two cores. Same interface as TwoThreads.
#pragma once

#include <cstdint>

#include "mechanics/coulomb.hpp"
#include "mechanics/links/links_memo.hpp"

namespace arm {

template <class S, class Stepper, class X = Real>
class OneThread {
 public:
  using Memory = typename Stepper::Memory;
  using Dynamics = typename Links<S, X>::Dynamics;

  OneThread(Real step, int, const Numbers<S, X>& numbers, const auto&... common)
      : n_(numbers), stepper_(step, numbers, common...) {}
  bool join_schedule() { return true; }
  void begin_thread() {}
  // The numbers of a lane have changed, or all.
  void update_tables(int lane) { stepper_.update_tables(lane); }
  void update_tables() {
    memo_.invalidate();
    stepper_.update_tables();
  }
  void reset(const State<S, X>& x) {
    memo_.invalidate();
    stepper_.reset(x);
  }
  Memory memory() const { return stepper_.memory(); }
  // Torques on the links may have changed, too.
  void restore(const Memory& memory) {
    memo_.invalidate();
    stepper_.restore(memory);
  }
  void begin_burst(std::int64_t, const State<S, X>&) {}
  void end_burst() {}
  ARM_INLINE void step(State<S, X>& x, const X (&u)[Stepper::row]) {
    if constexpr (requires { stepper_.find_links_at(x); }) {
      stepper_.step(x, u, stepper_.find_links_at(x), *this);
      return;
    }
    Dynamics links;
    if constexpr (can_rest) {
      links = memo_.find_at(n_, x);
      return stepper_.step(x, u, links, *this);
    }
    // Inlined, so that its constants fold with the step's; loops over many joints have none, and
    // run faster in a function of their own.
    if constexpr (S::N > kUnrollNested)
      Links<S, X>::compute_dynamics_apart(n_, x.q, x.v, links);
    else
      Links<S, X>::compute_dynamics(n_, x.q, x.v, links);
    stepper_.step(x, u, links, *this);
  }
  Stepper& stepper() { return stepper_; }
  void set_meter(auto* meter) { stepper_.set_meter(meter); }
  ARM_INLINE void receive_links(Dynamics&) {}  // it is there already
  ARM_INLINE void send_state(const State<S, X>&) {}

 private:
  // Whether the links of this machine may rest exactly: then their part is that of the last step.
  static constexpr bool can_rest =
      Coulomb<S, X>::present && std::is_same_v<X, double> && S::N <= kUnrollNested;

  struct NoMemo {
    void invalidate() {}
  };
  const Numbers<S, X>& n_;
  Stepper stepper_;
  [[no_unique_address]] std::conditional_t<can_rest, LinksMemo<S, X>, NoMemo> memo_;
};

}  // namespace arm
