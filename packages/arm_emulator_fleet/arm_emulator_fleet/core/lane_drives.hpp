// Machines side by side whose smooth steps are taken together, and the others each by itself.
//
// A step is smooth for a machine whose drives are in their regular modes at its start and at its
// end, whose brakes are open and, where events are located, whose links slide or rest all along.
// Such a step equals the one of a single machine. Most steps are smooth. A machine that meets a
// current limit, a stop, a brake or a located event takes that step alone and continues in its
// lane.
#pragma once

#include "mechanics/algebraic_states.hpp"
#include "mechanics/links/links_memo.hpp"
#include "mechanics/modes.hpp"
#include "mechanics/regular_mode.hpp"
#include "schemes/scheme.hpp"

namespace arm {

// Whether the lanes of a scene need this.
template <class S>
inline constexpr bool kStepsApart = max_modes<S>() > 0 || S::brakes > 0 || kLocates<S>;

template <class S, class X, class Machine>
class SmoothTogether {
 public:
  using Method = MethodOf<S, X>;
  using Memory = typename Method::Memory;
  using Dynamics = typename Links<S, X>::Dynamics;
  static constexpr int N = S::N, width = kWidth<X>, row = Method::row;

  SmoothTogether(double step, const Numbers<S, X>& numbers, const auto&... common)
      : n_(numbers), method_(step, numbers, common...), coulomb_(numbers) {}

  // The machine of a lane; null for an unused lane.
  void put(int lane, Machine* machine) {
    machine_[lane] = machine;
    there_[lane] = machine ? -1 : 0;
  }
  void renew(int lane) {
    forget_links();
    method_.renew(lane);
  }
  // The torques on the links have changed.
  void forget_links() {
    memo_.forget();
    confirmed_ = false;
  }
  void reset(const State<S, X>& x) {
    confirmed_ = false;
    method_.reset(x);
  }
  Memory memory() const { return method_.memory(); }
  // The lanes' states may have changed, too.
  void restore(const Memory& memory) {
    confirmed_ = false;
    method_.restore(memory);
  }
  const Dynamics& links_at(const State<S, X>& x) { return memo_.at(n_, x); }

  template <class Exchange>
  ARM_INLINE void step(State<S, X>& x, const X (&u)[row], const Dynamics& links,
                       Exchange& exchange) {
    State<S, X> start = x;
    const Attempt of = attempt(x, u, links, exchange);
    if (any(of.alone)) {
      Memory past = memory_before(of);
      Memory later = method_.memory();
      for (int lane = 0; lane < width; ++lane) {
        if (!of.alone[lane]) continue;
        if constexpr (locates)
          if (of.begins[lane]) {
            cut_alone(lane, start, u, x, later);
            continue;
          }
        step_alone(lane, start, past, u, x, later);
      }
      restore(later);
    }
  }
  // A step that no machine has to take alone; where one has to, it returns false and changes
  // nothing.
  template <class Exchange>
  ARM_INLINE bool step_smoothly(State<S, X>& x, const X (&u)[row], Exchange& exchange) {
    const State<S, X> start = x;
    const Attempt of = attempt(x, u, links_at(x), exchange);
    if (!any(of.alone)) return true;
    x = start;
    restore(memory_before(of));
    return false;
  }

 private:
  // A step of all lanes: in which it was smooth at its start, which must take it alone, and whether
  // the method took it at all.
  struct Attempt {
    Mask<X> begins, alone;
    bool taken;
  };
  template <class Exchange>
  ARM_INLINE Attempt attempt(State<S, X>& x, const X (&u)[row], const Dynamics& links,
                             Exchange& exchange) {
    Mask<X> jumps = {};
    if constexpr (locates) jumps = follow(x, u);
    Mask<X> smooth = n_.brakes_open() & is_regular(n_, x, u);
    const Mask<X> begins = smooth & ~jumps;
    const bool together = any(smooth & there_);
    if (together) {
      if constexpr (locates)
        smooth &= locate(x, u, links);
      else
        smooth &= take(x, u, links, exchange);
    }
    return {begins, there_ & ~smooth, together};
  }
  Memory memory_before(const Attempt& of) const {
    return of.taken ? method_.memory_before() : method_.memory();
  }

  static constexpr bool locates = kLocates<S>;
  using Friction = Coulomb<S, X>;

  // A step of all lanes. Returns where it was smooth.
  template <class Exchange>
  ARM_INLINE Mask<X> take(State<S, X>& x, const X (&u)[row], Dynamics links, Exchange& exchange) {
    State<S, X> drives_end = x;
    method_.step(x, u, links, exchange);
    if constexpr (requires { Method::holds_links; })
      for (int k = 0; k < State<S, X>::K; ++k)
        for (int j = 0; j < N; ++j) drives_end.z[k][j] = x.z[k][j];
    else
      drives_end = x;
    return is_regular(n_, drives_end, u);
  }
  // The same with location of events.
  Mask<X> locate(State<S, X>& x, const X (&u)[row], const Dynamics& links) {
    if constexpr (Friction::present)
      if (!confirmed_) find_friction(x, u, links);
    if (rest_)
      method_.step_at_rest(x, u, links);
    else
      method_.step_using_up(memo_.used_up(), modes_, x, u);
    Mask<X> smooth = X{} == X{};
    if constexpr (Friction::present) smooth = friction_holds(modes_, x, u);
    follow(x, u);
    return smooth & is_regular(n_, x, u);
  }

  void find_friction(const State<S, X>& x, const X (&u)[row], const Dynamics& links) {
    X rhs[N];
    torques(x, u, links, rhs);
    coulomb_.take(x, x, u, regular_modes);
    coulomb_.decide([&] { return loaded(links); }, x.v, rhs);
    modes_ = coulomb_.modes();
    rest_ = modes_.rest();
  }
  Mask<X> friction_holds(const typename Friction::Modes& modes, const State<S, X>& y,
                         const X (&u)[row]) {
    Mask<X> hold = X{} == X{};
    for (int j = 0; j < N; ++j) hold &= y.v[j] * modes.direction[j] >= 0.0;
    if (modes.lock()) {
      const Dynamics& links = memo_.at(n_, y);
      X rhs[N];
      torques(y, u, links, rhs);
      coulomb_.take(y, y, u, regular_modes);
      coulomb_.hold_in(modes, [&] { return loaded(links); }, rhs);
      for (int j = 0; j < N; ++j) hold &= select(modes.locked[j], coulomb_.spare(j), X{}) >= 0.0;
    }
    confirmed_ = coulomb_.confirms(modes, y.v);
    return hold;
  }

  // M with the rotors that the links carry.
  auto loaded(const Dynamics& links) const {
    auto M = links.M;
    for (int j = 0; j < N; ++j) M.at[j][j] += n_.carried(j);
    return M;
  }
  // Torques that accelerate the links, without dry friction.
  void torques(const State<S, X>& x, const X* u, const Dynamics& links, X* rhs) const {
    const auto put = [&](int j, const X& g)
                         __attribute__((always_inline)) { rhs[j] = g - links.nle[j]; };
    if constexpr (Numbers<S, X>::drives_vary) {
      X g[N];
      for (int lane = 0; lane < width; ++lane)
        n_.for_each_drive_of(lane, [&](const auto& drive, int j) {
          g[j][lane] = drive.rates(input_in_lane(drive, j, x, u[j], lane), 0).g;
        });
      for (int j = 0; j < N; ++j) put(j, g[j]);
    } else {
      n_.for_each_drive([&](const auto& drive, int j) __attribute__((always_inline)) {
        put(j, drive.rates(input_of(drive, j, x, u[j]), 0).g);
      });
    }
  }
  static constexpr auto regular_modes = []<class Drive>(const Drive&, int, int) {
    return typename Drive::Modes{};
  };

  // Set the algebraic states. Returns in which lanes a drive has one.
  Mask<X> follow(State<S, X>& x, const X* u) {
    Mask<X> has = {};
    for (int lane = 0; lane < width; ++lane)
      n_.for_each_drive_of(lane, [&](const auto& drive, int j) __attribute__((always_inline)) {
        if (!drive.follows_at_once()) return;
        has[lane] = -1;
        confirmed_ = false;
        auto at = input_in_lane(drive, j, x, u[j], lane);
        drive.follow(at);
        put_states(drive, j, lane, at, x);
      });
    return has;
  }

  using OfOne = typename Machine::Threads::Memory;

  // Take the step of one lane from `start` by its machine.
  ARM_APART void step_alone(int lane, State<S, X>& start, Memory& past, const X (&commands)[row],
                            State<S, X>& end, Memory& later) const {
    State<S> x;
    OfOne memory = {};
    double u[Machine::Stepper::row];
    take_lane(lane, commands, u), take_lane(lane, start, x), take_lane(lane, past, memory);
    machine_[lane]->step_alone(x, u, memory);
    put_lane(lane, x, end), put_lane(lane, memory, later);
  }
  // The same of one that was smooth at its start: `end` is its end without events.
  ARM_APART void cut_alone(int lane, State<S, X>& start, const X (&commands)[row], State<S, X>& end,
                           Memory& later) const {
    State<S> x, y;
    OfOne memory = {};
    double u[Machine::Stepper::row];
    take_lane(lane, commands, u), take_lane(lane, start, x), take_lane(lane, end, y),
        take_lane(lane, later, memory);
    typename Coulomb<S, Real>::Modes links;
    for (int j = 0; j < N; ++j)
      links.locked[j] = modes_.locked[j][lane] != 0, links.direction[j] = modes_.direction[j][lane];
    machine_[lane]->step_alone_to(y, links, x, u, memory);
    put_lane(lane, x, end), put_lane(lane, memory, later);
  }

  // Copies of a lane's numbers; what is copied is only read.
  static void take_lane(int lane, const X (&commands)[row], double (&u)[Machine::Stepper::row]) {
    for (double& one : u) one = 0.0;
    for (int j = 0; j < N; ++j) u[j] = commands[j][lane];
  }
  static void take_lane(int lane, auto& from, auto& to) {
    double numbers[sizeof to / sizeof(double) + 1];
    double *next = numbers, *first = numbers;
    for_each_number_of(from, [&](const X& number) { *next++ = number[lane]; });
    for_each_number_of(to, [&](double& number) { number = *first++; });
  }
  static void put_lane(int lane, auto& from, auto& to) {
    double numbers[sizeof from / sizeof(double) + 1];
    double *next = numbers, *first = numbers;
    for_each_number_of(from, [&](double number) { *next++ = number; });
    for_each_number_of(to, [&](X& number) { number[lane] = *first++; });
  }
  template <class Y>
  static void for_each_number_of(State<S, Y>& of, auto&& number) {
    for_each_number(of, number);
  }
  static void for_each_number_of(auto& of, auto&& number) { of.for_each_number(number); }

  const Numbers<S, X>& n_;
  Method method_;
  Friction coulomb_;
  LinksMemo<S, X> memo_;
  // Modes of a step, and whether its end calls for them again: then they are those of the next.
  typename Friction::Modes modes_ = {};
  bool confirmed_ = false;
  bool rest_ = false;  // all links of all lanes
  Machine* machine_[width] = {};
  Mask<X> there_ = {};
};

}  // namespace arm
