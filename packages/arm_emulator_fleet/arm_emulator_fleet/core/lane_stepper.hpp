// Machines in lanes whose smooth steps are taken together, and the others each by its machine.
//
// A step is smooth for a machine whose drives are in their regular modes at its start and end, and
// whose brakes are open. Where events are located, its links must also slide or rest all
// along. Such a step equals the one of a single machine. Most steps are smooth. A machine that
// meets a
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
inline constexpr bool kHasLaneEvents = max_modes<S>() > 0 || S::brakes > 0 || kLocatesEvents<S>;

template <class S, class X, class Machine>
class LaneStepper {
 public:
  using Method = MethodOf<S, X>;
  using Memory = typename Method::Memory;
  using Dynamics = typename Links<S, X>::Dynamics;
  static constexpr int N = S::N, width = kWidth<X>, row = Method::row;

  LaneStepper(double step, const Numbers<S, X>& numbers, const auto&... common)
      : n_(numbers), method_(step, numbers, common...), coulomb_(numbers) {}

  // The machine of a lane; null for an unused lane.
  void set_machine(int lane, Machine* machine) {
    machine_[lane] = machine;
    is_used_[lane] = machine ? -1 : 0;
  }
  void update_tables(int lane) {
    invalidate_links();
    method_.update_tables(lane);
  }
  // The torques on the links have changed.
  void invalidate_links() {
    memo_.invalidate();
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
  const Dynamics& find_links_at(const State<S, X>& x) { return memo_.find_at(n_, x); }

  template <class Exchange>
  ARM_INLINE void step(State<S, X>& x, const X (&u)[row], const Dynamics& links,
                       Exchange& exchange) {
    State<S, X> start = x;
    const Attempt attempt = attempt_step(x, u, links, exchange);
    if (any(attempt.is_separate)) {
      Memory past = find_memory_before(attempt);
      Memory later = method_.memory();
      for (int lane = 0; lane < width; ++lane) {
        if (!attempt.is_separate[lane]) continue;
        if constexpr (locates)
          if (attempt.is_smooth_at_start[lane]) {
            step_lane_to_event(lane, start, u, x, later);
            continue;
          }
        step_state(lane, start, past, u, x, later);
      }
      restore(later);
    }
  }
  // A step that no machine has to take alone; where one has to, it returns false and changes
  // nothing.
  template <class Exchange>
  ARM_INLINE bool try_smooth_step(State<S, X>& x, const X (&u)[row], Exchange& exchange) {
    const State<S, X> start = x;
    const Attempt attempt = attempt_step(x, u, find_links_at(x), exchange);
    if (!any(attempt.is_separate)) return true;
    x = start;
    restore(find_memory_before(attempt));
    return false;
  }

 private:
  // A step of all lanes: in which it was smooth at its start, which must take it alone, and whether
  // the method took it at all.
  struct Attempt {
    Mask<X> is_smooth_at_start, is_separate;
    bool is_taken;
  };
  template <class Exchange>
  ARM_INLINE Attempt attempt_step(State<S, X>& x, const X (&u)[row], const Dynamics& links,
                                  Exchange& exchange) {
    Mask<X> jumps = {};
    if constexpr (locates) jumps = set_algebraic_states(x, u);
    Mask<X> smooth = n_.are_brakes_open() & is_regular(n_, x, u);
    const Mask<X> smooth_at_start = smooth & ~jumps;
    const bool takes_step = any(smooth & is_used_);
    if (takes_step) {
      if constexpr (locates)
        smooth &= step_locating_events(x, u, links);
      else
        smooth &= step_lanes(x, u, links, exchange);
    }
    return {smooth_at_start, is_used_ & ~smooth, takes_step};
  }
  Memory find_memory_before(const Attempt& attempt) const {
    return attempt.is_taken ? method_.find_memory_before() : method_.memory();
  }

  static constexpr bool locates = kLocatesEvents<S>;
  using Friction = Coulomb<S, X>;

  // A step of all lanes. Returns where it was smooth.
  template <class Exchange>
  ARM_INLINE Mask<X> step_lanes(State<S, X>& x, const X (&u)[row], Dynamics links,
                                Exchange& exchange) {
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
  Mask<X> step_locating_events(State<S, X>& x, const X (&u)[row], const Dynamics& links) {
    if constexpr (Friction::present)
      if (!confirmed_) find_friction(x, u, links);
    if (is_all_at_rest_)
      method_.step_at_rest(x, u, links);
    else
      method_.step_consuming_links(memo_.release_links(), modes_, x, u);
    Mask<X> smooth = X{} == X{};
    if constexpr (Friction::present) smooth = check_friction(modes_, x, u);
    set_algebraic_states(x, u);
    return smooth & is_regular(n_, x, u);
  }

  void find_friction(const State<S, X>& x, const X (&u)[row], const Dynamics& links) {
    X rhs[N];
    compute_torques(x, u, links, rhs);
    coulomb_.set_friction(x, x, u, regular_modes);
    coulomb_.decide([&] { return compute_loaded_inertia(links); }, x.v, rhs);
    modes_ = coulomb_.modes();
    is_all_at_rest_ = modes_.are_all_locked();
  }
  Mask<X> check_friction(const typename Friction::Modes& modes, const State<S, X>& y,
                         const X (&u)[row]) {
    Mask<X> hold = X{} == X{};
    for (int j = 0; j < N; ++j) hold &= y.v[j] * modes.direction[j] >= 0.0;
    if (modes.has_locked()) {
      const Dynamics& links = memo_.find_at(n_, y);
      X rhs[N];
      compute_torques(y, u, links, rhs);
      coulomb_.set_friction(y, y, u, regular_modes);
      coulomb_.find_lock_torques(modes, [&] { return compute_loaded_inertia(links); }, rhs);
      for (int j = 0; j < N; ++j)
        hold &= select(modes.locked[j], coulomb_.lock_margin(j), X{}) >= 0.0;
    }
    confirmed_ = coulomb_.is_confirmed(modes, y.v);
    return hold;
  }

  // M with the rotors that the links carry.
  auto compute_loaded_inertia(const Dynamics& links) const {
    auto M = links.M;
    for (int j = 0; j < N; ++j) M.at[j][j] += n_.carried(j);
    return M;
  }
  // Torques that accelerate the links, without dry friction.
  void compute_torques(const State<S, X>& x, const X* u, const Dynamics& links, X* rhs) const {
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
  Mask<X> set_algebraic_states(State<S, X>& x, const X* u) {
    Mask<X> has = {};
    for (int lane = 0; lane < width; ++lane)
      n_.for_each_drive_of(lane, [&](const auto& drive, int j) __attribute__((always_inline)) {
        if (!drive.has_algebraic_state()) return;
        has[lane] = -1;
        confirmed_ = false;
        auto at = input_in_lane(drive, j, x, u[j], lane);
        drive.set_algebraic_state(at);
        store_states(drive, j, lane, at, x);
      });
    return has;
  }

  using MachineMemory = typename Machine::Threads::Memory;

  // Take the step of one lane from `start` by its machine.
  ARM_APART void step_state(int lane, State<S, X>& start, Memory& past, const X (&commands)[row],
                            State<S, X>& end, Memory& later) const {
    State<S> x;
    MachineMemory memory = {};
    double u[Machine::Stepper::row];
    read_lane(lane, commands, u), read_lane(lane, start, x), read_lane(lane, past, memory);
    machine_[lane]->step_state(x, u, memory);
    write_lane(lane, x, end), write_lane(lane, memory, later);
  }
  // The same of one that was smooth at its start: `end` is its end without events.
  ARM_APART void step_lane_to_event(int lane, State<S, X>& start, const X (&commands)[row],
                                    State<S, X>& end, Memory& later) const {
    State<S> x, y;
    MachineMemory memory = {};
    double u[Machine::Stepper::row];
    read_lane(lane, commands, u), read_lane(lane, start, x), read_lane(lane, end, y),
        read_lane(lane, later, memory);
    typename Coulomb<S, Real>::Modes links;
    for (int j = 0; j < N; ++j)
      links.locked[j] = modes_.locked[j][lane] != 0, links.direction[j] = modes_.direction[j][lane];
    machine_[lane]->step_state_to(y, links, x, u, memory);
    write_lane(lane, x, end), write_lane(lane, memory, later);
  }

  // Copies of a lane's numbers; what is copied is only read.
  static void read_lane(int lane, const X (&commands)[row], double (&u)[Machine::Stepper::row]) {
    for (double& number : u) number = 0.0;
    for (int j = 0; j < N; ++j) u[j] = commands[j][lane];
  }
  static void read_lane(int lane, auto& from, auto& to) {
    double numbers[sizeof to / sizeof(double) + 1];
    double *next = numbers, *first = numbers;
    for_each_number_of(from, [&](const X& number) { *next++ = number[lane]; });
    for_each_number_of(to, [&](double& number) { number = *first++; });
  }
  static void write_lane(int lane, auto& from, auto& to) {
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
  bool is_all_at_rest_ = false;  // all links of all lanes
  Machine* machine_[width] = {};
  Mask<X> is_used_ = {};
};

}  // namespace arm
