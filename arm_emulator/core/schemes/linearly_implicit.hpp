// Linearly implicit schemes: implicit Euler, and the Rosenbrock method ROS2 in two forms.
//
// All solve (I - s A) k = r, s = gamma h, for the rates k of the state x = (z, q, v). A is the part
// of the Jacobian that is stiff and cheap: the drive of each joint by itself, viscous friction
// included (drive_table.hpp). A leaves out how nle and M change with q and v.
//
//   implicit      k = f(x),  x' = x + h k                                       (gamma = 1)
//   rosenbrock    (I - s A) k1 = f(x)
//                 (I - s A) K2 = f(x + h k1) - 2 k1,  x' = x + h (3 k1 + K2) / 2
//
// ROS2 is a W-method: of order 2 with any A (Verwer, Spee, Blom and Hundsdorfer, SIAM J. Sci.
// Comput. 20, 1999), and L-stable in what A holds for gamma = 1 - 1/sqrt(2). The part in A needs no
// second evaluation: f(x + h k1) = f(x) + h A k1 + d, where h A k1 = (k1 - f(x)) / gamma. d is the
// change of the links' part. With K2 = (1 - 1/gamma) k1 + k2 and 1/gamma - 2 = sqrt(2)
//
//                 (I - s A) k2 = sqrt(2) k1 + d,  x' = x + h (gamma k1 + k2 / 2)
//
// d has torques on the links: M(x) k1 + nle(x) - M(y) k1 - nle(y) at y = x + h k1. (That is
// M(x) f_v(y) - M(x) f_v(x) with k1 in the place of f_v(y) where M(x) - M(y) multiplies it: the
// error is O(h^2), which order 2 allows.)
//
//   rosenbrock    works it out at y: one inverse dynamics with the accelerations k1.
//   extrapolated  takes its change from the last step: each step evaluates the links
//                 only once. The error is O(h^2) again; where an acceleration jumps it is O(h),
//                 but in the one step after it, which keeps the order.
//
// Drives that are not linear add their nonlinear part n (drive.hpp) to f, and n(y) - n(x) to d:
// both schemes evaluate it, joint by joint. All schemes here solve one equation, hence the length.
#pragma once

#include "mechanics/coulomb.hpp"
#include "mechanics/links/links.hpp"
#include "mechanics/modes.hpp"
#include "mechanics/regular_mode.hpp"
#include "schemes/drive_tables.hpp"
#include "schemes/scheme.hpp"
#include "schemes/trial_drives.hpp"

namespace arm {

// `Tables` gives the drives' parts of a step.
template <class S, class X = Real, class Tables = DriveTables<S, X, MakeImplicit>>
class LinearlyImplicit {
 public:
  static constexpr int N = S::N, K = max_states<S>();
  using Dynamics = typename Links<S, X>::Dynamics;
  using Drives = Tables;
  using In = typename Tables::In;
  static constexpr int row = Tables::row;
  // Takes steps of any length in modes that are known (event_location.hpp).
  using Part = LinearlyImplicit<S, X, TrialDrives<S>>;

  // `common`: tables of `make_common`, if lanes refer to some.
  LinearlyImplicit(Real step, const arm::Numbers<S, X>& numbers, const auto&... common)
      : h_(step), n_(numbers), tables_(numbers, {step, stages}, common...), coulomb_(numbers) {}
  static auto make_common(Real step, const arm::Numbers<S, X>& numbers) {
    using Common = typename Tables::Common;
    if constexpr (std::is_same_v<Common, Nothing>)
      return Common();
    else
      return Common(numbers, {step, stages});
  }
  // For steps of another length in these modes, by `step_in_modes`.
  void set_step(Real step, const Modes<S>& modes) {
    h_ = step;
    set_modes(modes);
    tables_.set_step({step, stages});
  }

  ~LinearlyImplicit() { delete half_; }
  LinearlyImplicit(const LinearlyImplicit&) = delete;
  LinearlyImplicit& operator=(const LinearlyImplicit&) = delete;

  // The numbers of a lane have changed, or all.
  void update_tables(int lane) { tables_.update_tables(lane); }
  void update_tables() {
    tables_.fill();
    regular_ = true;
    if (half_) half_->update_tables();
  }

  // The links' accelerations in the first stage, and the torques M a + nle that they take there.
  struct Accelerations {
    alignas(64) X a[row], torque[row];

    // number(x) for all of them, in a fixed order.
    template <class Number>
    void for_each_number(Number&& number) {
      for (int j = 0; j < N; ++j) number(a[j]), number(torque[j]);
    }
  };
  using Memory = Accelerations;  // data of the last step, besides the state

  // Begin at a state with no past.
  void reset(const State<S, X>& x) {
    past() = {};
    if constexpr (!extrapolates) return;
    compute_inverse_dynamics_apart<S>(n_, x.q, x.v, past().a, past().torque);
  }
  const Memory& memory() const { return past_[newest_]; }
  Memory& past() { return past_[newest_]; }
  Tables& tables() { return tables_; }
  // The memory before the newest step, of lanes.
  const Memory& find_memory_before() const { return past_[memories - 1 - newest_]; }
  void restore(const Memory& memory) { past() = memory; }

  // Serve the drives in these modes.
  void set_modes(const Modes<S>& modes) {
    if constexpr (Tables::modal)
      for (int j = 0; j < N; ++j) tables_.set_modes(j, modes.drive[j]);
  }
  // A step in the given modes, whether they hold or not (event_location.hpp).
  void step_in_modes(const Modes<S>& modes, State<S>& x, const Real (&u)[row], Dynamics links) {
    set_modes(modes);
    step_consuming_links(links, modes.friction, x, u);
  }
  // A step with the drives in the modes of the tables.
  void step_in_modes(const typename Coulomb<S, X>::Modes& friction, State<S, X>& x,
                     const X (&u)[row], Dynamics links) {
    step_consuming_links(links, friction, x, u);
  }
  void step_consuming_links(Dynamics& links, const typename Coulomb<S, X>::Modes& friction,
                            State<S, X>& x, const X (&u)[row]) {
    Inputs in;
    load_inputs(x, u, in);
    if constexpr (Tables::modal) tables_.write_modes(in);
    Accelerations own;
    Accelerations& k1 = next_memory(own);
    begin_link_stage(x, u, in, k1);
    compute_stages(x, u, links, in, k1, friction);
    move_links(x, in);
    move_drives(x, in);
  }

  // A step in which all links rest under these torques: nothing is left to solve.
  void step_at_rest(State<S, X>& x, const X (&u)[row], const Dynamics& links) {
    static_assert(stages == 2);
    Inputs in;
    load_inputs(x, u, in);
    if constexpr (Tables::modal) tables_.write_modes(in);
    Accelerations own;
    Accelerations& k1 = next_memory(own);
    begin_link_stage<true>(x, u, in, k1);
    for_each<N>([&](auto j) __attribute__((always_inline)) {
      k1.torque[j] -= k1.torque[j] - links.nle[j];
      k1.a[j] = X{};
    });
    store_past(k1);
    if constexpr (!Tables::linear) {
      X none[row];
      evaluate_nonlinear_change<true>(u, in, none);
    }
    move_drives<true>(x, in);
  }

  // Set the past for a step from `start` to x that was taken otherwise; links and modes are those
  // at x.
  void set_past(const State<S, X>& start, const State<S, X>& x, const X (&u)[row],
                const Dynamics& links, const Modes<S>& modes) {
    if constexpr (extrapolates) {
      X a[N];
      modes.compute_accelerations(x, u, links, a, coulomb_);
      compute_link_torques<S>(n_, start.q, start.v, a, past().torque);
      for (int j = 0; j < N; ++j) past().a[j] = a[j];
    }
  }

  // From sample k to k + 1 under the commands u. The links' part comes from `exchange`, which is
  // given the links as soon as they have moved on (two_threads.hpp).
  template <class Exchange>
  ARM_INLINE void step(State<S, X>& x, const X (&u)[row], Dynamics& links, Exchange& exchange) {
    Inputs in;
    load_inputs(x, u, in);
    if constexpr (!Tables::modal) {
      Accelerations own;
      Accelerations& k1 = next_memory(own);
      begin_link_stage(x, u, in, k1);
      exchange.receive_links(links);
      compute_stages(x, u, links, in, k1, Undecided());
      move_links(x, in);
      coulomb_.stop_reversed(x.v);
      exchange.send_state(x);
      move_drives(x, in);
    } else {
      exchange.receive_links(links);
      search_modes(x, u, links, in);
      exchange.send_state(x);
    }
  }

 private:
  using Inputs = typename Tables::Inputs;
  static constexpr bool extrapolates = S::Scheme::extrapolates;
  static constexpr bool locates = kLocatesEvents<S>;
  static constexpr int stages = S::Scheme::stages;
  static constexpr double gamma = find_gamma(stages);
  using Numbers = Row<N, X>;
  // In the place of the modes of the links, which the step then decides.
  struct Undecided {};

  Accelerations& next_memory(Accelerations& own) {
    if constexpr (memories == 2)
      return past_[1 - newest_];
    else
      return own;
  }

  ARM_INLINE void store_past(const Accelerations& k1) {
    if constexpr (memories == 2)
      newest_ = 1 - newest_;
    else if constexpr (extrapolates)
      past() = k1;
  }

  ARM_INLINE void load_inputs(State<S, X>& x, const X (&u)[row], Inputs& in) const {
    if constexpr (kHasStartStates<S>) set_start_states(n_, x, u);
    for_each<K, kMaxStates>([&](auto k)
                                __attribute__((always_inline)) { in[k] = Numbers::load(x.z[k]); });
    in[In::q] = Numbers::load(x.q);
    in[In::v] = Numbers::load(x.v);
    in[In::u] = Numbers::load(u);
    in[In::k1] = in[In::k2] = {};
  }

  // The torques of the drives in the links' first stage go to `k1.torque`.
  template <bool at_rest = false>
  ARM_INLINE void begin_link_stage(const State<S, X>& x, const X (&u)[row], Inputs& in,
                                   Accelerations& k1) {
    if constexpr (!Tables::linear) tables_.compute_nonlinear_parts(x, u).write(in);
    tables_.template compute_first_rhs<at_rest>(in).store(k1.torque);
  }

  // k1 and k2 of the links. `k1.torque` holds rhs_1.
  ARM_INLINE void compute_stages(const State<S, X>& x, const X (&u)[row], Dynamics& links,
                                 Inputs& in, Accelerations& k1, const auto& friction) {
    for_each<N>([&](auto j) __attribute__((always_inline)) { links.M.at[j][j] += n_.carried(j); });
    if constexpr (Coulomb<S, X>::loaded)
      coulomb_.set_friction(x, pull_drives_at_rest(x, in), u, tables_.modes());
    else
      coulomb_.set_friction(x, x, u, tables_.modes());
    X change[row] = {};
    constexpr bool has_past = extrapolates && Tables::has_past;
    if constexpr (has_past) extrapolate_torque_change(links, change);
    compute_first_stage(x, links, in, k1, friction);
    store_past(k1);
    if constexpr (stages == 2 && !has_past) evaluate_torque_change(x, k1, change);
    if constexpr (stages == 2 && !Tables::linear) evaluate_nonlinear_change(u, in, change);
    if constexpr (stages == 2) compute_second_stage(links, change, in);
  }

  // x with the drives after the first stage, the links at rest: the torque of a command that has
  // jumped acts there, and load friction must follow it.
  ARM_INLINE State<S, X> pull_drives_at_rest(const State<S, X>& x, const Inputs& in) {
    State<S, X> pulled = x;
    for_each<K, kMaxStates>([&](auto k) __attribute__((always_inline)) {
      Numbers z = tables_.compute_rates_at_rest(k, in);
      for_each<Numbers::groups>([&](auto g) __attribute__((always_inline)) {
        z.at[g] = fma(gamma * h_, z.at[g], in[k].at[g]);
      });
      z.store(pulled.z[k]);
    });
    return pulled;
  }

  ARM_INLINE void compute_first_stage(const State<S, X>& x, Dynamics& links, Inputs& in,
                                      Accelerations& k1, const auto& friction) {
    for_each<N>([&](auto j) __attribute__((always_inline)) {
      k1.a[j] = k1.torque[j] - links.nle[j];
      links.M.at[j][j] += tables_.diagonal[j];
    });
    solve(links, x, k1, friction);
    for_each<N>([&](auto j) __attribute__((always_inline)) {
      k1.torque[j] = fma(-tables_.diagonal[j], k1.a[j], k1.torque[j] - coulomb_.force(j));
    });
    in[In::k1] = Numbers::gather(k1.a);
  }

  ARM_INLINE void solve(Dynamics& links, const State<S, X>&, Accelerations& k1,
                        const typename Coulomb<S, X>::Modes& friction) {
    coulomb_.solve_in(friction, links.M.at, k1.a);
  }
  ARM_INLINE void solve(Dynamics& links, const State<S, X>& x, Accelerations& k1, Undecided) {
    if constexpr (locates)
      coulomb_.solve_apart(links.M.at, x.v, k1.a);
    else
      coulomb_.solve(links.M.at, x.v, k1.a);
  }

  ARM_INLINE void compute_second_stage(const Dynamics& links, const X (&change)[row], Inputs& in) {
    alignas(64) X k2[row];
    tables_.compute_second_rhs(in).store(k2);
    for_each<N>([&](auto j) __attribute__((always_inline)) {
      k2[j] = fma(-kSqrt2, links.nle[j] + coulomb_.force(j), k2[j] + change[j]);
    });
    coulomb_.solve_again(k2);
    in[In::k2] = Numbers::gather(k2);
  }

  // The drives' part of d: how their nonlinear parts, and friction of the links that varies, change
  // from x to x + h k1.
  template <bool at_rest = false>
  ARM_INLINE void evaluate_nonlinear_change(const X (&u)[row], Inputs& in, X (&change)[row]) {
    State<S, X> y;
    Numbers number;
    const auto store = [&](auto&& of_group, X(&to)[row]) __attribute__((always_inline)) {
      for_each<Numbers::groups>([&](auto g)
                                    __attribute__((always_inline)) { number.at[g] = of_group(g); });
      number.store(to);
    };
    for_each<K, kMaxStates>([&](auto k) __attribute__((always_inline)) {
      const Numbers rate = tables_.template compute_rates<at_rest>(k, in);
      store([&](auto g) { return fma(h_, rate.at[g], in[k].at[g]); }, y.z[k]);
    });
    store(
        [&](auto g) {
          return fma(h_, fma(gamma * h_, in[In::k1].at[g], in[In::v].at[g]), in[In::q].at[g]);
        },
        y.q);
    store([&](auto g) { return fma(h_, in[In::k1].at[g], in[In::v].at[g]); }, y.v);
    if constexpr (!at_rest && Coulomb<S, X>::varies)
      coulomb_.add_change(y, u, tables_.modes(), change);
    const auto nonlinear = tables_.compute_nonlinear_parts(y, u);
    for_each<Tables::R, kMaxInputs>([&](auto r) __attribute__((always_inline)) {
      if (!Tables::is_input_used(In::nonlinear + r)) return;
      const Numbers there = Numbers::gather(nonlinear.at[r]);
      for_each<Numbers::groups>([&](auto g) __attribute__((always_inline)) {
        in[In::change + r].at[g] = there.at[g] - in[In::nonlinear + r].at[g];
      });
    });
  }

  // d of `rosenbrock`.
  ARM_INLINE void evaluate_torque_change(const State<S, X>& x, const Accelerations& k1,
                                         X (&change)[row]) const {
    X q[N], v[N];
    for_each<N>([&](auto j) __attribute__((always_inline)) {
      q[j] = fma(h_, fma(gamma * h_, k1.a[j], x.v[j]), x.q[j]);
      v[j] = fma(h_, k1.a[j], x.v[j]);
    });
    if constexpr (Tables::has_past) {
      typename Links<S, X>::Kinematics kinematics;
      Links<S, X>::compute_kinematics(n_, q, kinematics);
      Links<S, X>::compute_inverse_dynamics(n_, kinematics, v, k1.a, change);
    } else {
      compute_inverse_dynamics_apart<S>(n_, q, v, k1.a, change);
    }
    for_each<N>([&](auto j) __attribute__((always_inline)) {
      change[j] = fma(-n_.carried(j), k1.a[j], k1.torque[j] - change[j]);
    });
  }

  // d of `extrapolated`: the torques M a + nle, for the accelerations of the step before, there and
  // here.
  ARM_INLINE void extrapolate_torque_change(const Dynamics& links, X (&change)[row]) const {
    const auto& M = links.M.at;
    const Memory& past = memory();
    for_each<N>([&](auto j) __attribute__((always_inline)) {
      change[j] = fma(-M[j][j], past.a[j], past.torque[j] - links.nle[j]);
    });
    for_each<N>([&](auto j) __attribute__((always_inline)) {
      for_each_from<N>(next(j), [&](auto k) __attribute__((always_inline)) {
        change[j] = fma(-M[j][k], past.a[k], change[j]);
        change[k] = fma(-M[j][k], past.a[j], change[k]);
      });
    });
  }

  ARM_INLINE void move_links(State<S, X>& x, const Inputs& in) const {
    Numbers q, v;
    for_each<Numbers::groups>([&](auto g) __attribute__((always_inline)) {
      const auto k1 = in[In::k1].at[g], k2 = in[In::k2].at[g];
      q.at[g] = fma(h_, fma(gamma * h_, fma(0.5, k2, k1), in[In::v].at[g]), in[In::q].at[g]);
      v.at[g] = fma(h_, fma(gamma, k1, 0.5 * k2), in[In::v].at[g]);
    });
    q.store(x.q);
    v.store(x.v);
  }

  template <bool at_rest = false>
  ARM_INLINE void move_drives(State<S, X>& x, const Inputs& in) {
    Numbers z[K > 0 ? K : 1];
    tables_.template add_increments<stages, at_rest>(in, z);
    for_each<K, kMaxStates>([&](auto k) __attribute__((always_inline)) { z[k].store(x.z[k]); });
  }

  // A step is taken with the modes that hold at its end: a current has not passed its limit, one at
  // the limit is not drawn back by its own circuit, a stuck rotor is not overloaded. If none are
  // consistent, the step is halved. The shortest parts keep the modes of their start, so a mode
  // changes at most 2^-kMaxHalvings of a step too late. (Shorter ones need not help: a rotor that
  // a wound-up gear begins to pull gathers its speed with h^3, which the error of a step exceeds at
  // any h.)
  void search_modes(State<S>& x, const Real (&u)[row], const Dynamics& links, Inputs& in) {
    if constexpr (locates)
      search_modes_rarely(x, u, links, in);
    else
      search_modes_inline(x, u, links, in);
  }
  // With located events: the rest of a step that has too many of them.
  ARM_ONCE void search_modes_rarely(State<S>& x, const Real (&u)[row], const Dynamics& links,
                                    Inputs& in) {
    search_modes_inline(x, u, links, in);
  }
  ARM_INLINE void search_modes_inline(State<S>& x, const Real (&u)[row], const Dynamics& links,
                                      Inputs& in) {
    constexpr int round_limit = 2 * N * Tables::M;
    const Memory memory = past();
    const bool begins_regular = regular_ && is_regular(n_, x, u);
    if (!begins_regular) tables_.set_modes_at(x, u);
    State<S> y;
    for (int round = 0, mark = 1;; ++round) {
      past() = memory;
      attempt_step(x, u, links, in, y);
      if (begins_regular && round == 0 && is_regular(n_, y, u)) {
        x = y;
        return;
      }
      const bool keeps = round > round_limit;  // those of the start, whether they hold or not
      if (keeps || tables_.correct_modes(x, y, u)) {
        x = y;
        tables_.enforce_modes(x, u);
        regular_ = !keeps && tables_.has_regular_modes();
        return;
      }
      // A round depends on its modes alone: those that come again would come in all further rounds.
      const bool comes_again = round > 0 && tables_.has_marked_modes();
      if (round + 1 == mark) tables_.mark_modes(), mark *= 2;
      if (round < round_limit && !comes_again) continue;
      if (can_halve()) break;
      tables_.set_modes_at(x, u);
      round = round_limit;
    }
    regular_ = false;
    past() = memory;
    halve(x, u);
  }

  // From x to y in the modes of the tables.
  ARM_INLINE_ON_HOST void attempt_step(const State<S>& x, const Real (&u)[row], Dynamics links,
                                       Inputs& in, State<S>& y) {
    Accelerations k1;
    y = x;
    tables_.write_modes(in);
    begin_link_stage(y, u, in, k1);
    compute_stages(y, u, links, in, k1, Undecided());
    move_links(y, in);
    coulomb_.stop_reversed(y.v);
    move_drives(y, in);
  }

  ARM_ONCE void halve(State<S>& x, const Real (&u)[row]) {
    if (!half_) {
      half_ = new LinearlyImplicit(0.5 * h_, n_);
      half_->halvings_ = halvings_ + 1;
    }
    half_->past() = past();
    half_->spare_ = spare_ - 1;
    for (int part = 0; part < 2; ++part) {
      Dynamics links;
      Inputs in;
      Links<S, X>::compute_dynamics_apart(n_, x.q, x.v, links);
      load_inputs(x, u, in);
      half_->search_modes(x, u, links, in);
    }
    past() = half_->past();
    spare_ = half_->spare_;
  }

  // Whether this part of a step may be halved. A step may need more parts than its events have.
  // Then it does not resolve the machine (a motor far faster than the step), and keeps modes
  // sooner.
  bool can_halve() {
    if (halvings_ == 0) spare_ = kMaxHalved;
    return halvings_ < kMaxHalvings && spare_ > 0;
  }

  static constexpr int kMaxHalvings = 12, kMaxHalved = 64;

  Real h_;
  const arm::Numbers<S, X>& n_;
  Tables tables_;
  bool regular_ = true;  // all joints are in their regular modes
  // Memories of the newest step, and in lanes of the step before: the next is written over that,
  // not copied.
  static constexpr int memories = extrapolates && kWidth<X> > 1 ? 2 : 1;
  Memory past_[memories] = {};
  int newest_ = 0;
  Coulomb<S, X> coulomb_;
  LinearlyImplicit* half_ = nullptr;  // made when it is first needed
  int halvings_ = 0;
  int spare_ = 0;  // further parts of a step that may be halved
};

struct Implicit : AnyScheme {
  static constexpr int stages = 1;
  template <class S, class X>
  using Method = LinearlyImplicit<S, X>;
};
struct Rosenbrock : AnyScheme {
  static constexpr int stages = 2;
  template <class S, class X>
  using Method = LinearlyImplicit<S, X>;
};
struct Extrapolated : Rosenbrock {
  static constexpr bool extrapolates = true;
};

}  // namespace arm
