// The paper's scheme: backward Euler for the motors, forward Euler for the links, one step for
// both.
#pragma once

#include "mechanics/algebraic_states.hpp"
#include "mechanics/coulomb.hpp"
#include "mechanics/links/links.hpp"
#include "schemes/drive_tables.hpp"
#include "schemes/scheme.hpp"

namespace arm {

template <class S, class X = Real>
class PaperScheme {
 public:
  static constexpr int N = S::N, K = max_states<S>();
  using Dynamics = typename Links<S, X>::Dynamics;
  using Tables = DriveTables<S, X, MakePaper>;
  using In = typename Tables::In;
  static constexpr int row = Tables::row;
  // Drives find the modes that hold at the step's end, with the link held.
  static constexpr bool holds_links = true;

  // `common`: tables of `make_common`, if lanes refer to some.
  PaperScheme(Real step, const Numbers<S, X>& numbers, const auto&... common)
      : h_(step), n_(numbers), tables_(numbers, {step}, common...), coulomb_(numbers) {}
  static auto make_common(Real step, const Numbers<S, X>& numbers) {
    using Common = typename Tables::Common;
    if constexpr (std::is_same_v<Common, Nothing>)
      return Common();
    else
      return Common(numbers, {step});
  }
  PaperScheme(const PaperScheme&) = delete;

  // The numbers of a lane have changed, or all.
  void update_tables(int lane) { tables_.update_tables(lane); }
  void update_tables() { tables_.fill(); }

  // The scheme has no past.
  struct Memory {
    template <class Number>
    void for_each_number(Number&&) {}
  };
  void reset(const State<S, X>&) {}
  Memory memory() const { return {}; }
  Memory find_memory_before() const { return {}; }
  void restore(Memory) {}

  // From sample k to k + 1 under the commands u. The links' part comes from `exchange`, which is
  // given the links as soon as they have moved on (two_threads.hpp).
  template <class Exchange>
  ARM_INLINE void step(State<S, X>& x, const X (&u)[row], Dynamics& links, Exchange& exchange) {
    alignas(64) X a[row];
    step_drives(x, u, a);
    exchange.receive_links(links);
    compute_accelerations(x, u, links, a);
    integrate(x, a);
    exchange.send_state(x);
  }

 private:
  // Eq. (3), the links held at sample k; `torque`: of the drives on the links after it.
  ARM_INLINE void step_drives(State<S, X>& x, const X (&u)[row], X (&torque)[row]) {
    if constexpr (kHasStartStates<S>) set_start_states(n_, x, u);
    typename Tables::Inputs in;
    for_each<K, kMaxStates>(
        [&](auto k) __attribute__((always_inline)) { in[k] = Row<N, X>::load(x.z[k]); });
    in[In::q] = Row<N, X>::load(x.q);
    in[In::v] = Row<N, X>::load(x.v);
    in[In::u] = Row<N, X>::load(u);
    if constexpr (Tables::modal) choose_modes(x, u, in);
    if constexpr (!Tables::linear) tables_.compute_nonlinear_parts(x, u).write(in);
    Tables::template multiply<In::k1>(tables_.rhs_1, in, Tables::link).store(torque);
    for_each<K, kMaxStates>([&](auto k) __attribute__((always_inline)) {
      auto z = Tables::template multiply<In::k1>(tables_.dz[k], in, k);
      for_each<z.groups>([&](auto g) __attribute__((always_inline)) { z.at[g] += in[k].at[g]; });
      z.store(x.z[k]);
    });
    if constexpr (Tables::modal) tables_.enforce_modes(x, u);
  }

  // The modes that hold at the end of the step, the link held: each drive finds its own.
  void choose_modes(const State<S, X>& x, const X (&u)[row], typename Tables::Inputs& in) {
    n_.for_each_drive([&]<class Drive>(const Drive& drive, int j) {
      if constexpr (Drive::modes > 0) {
        const auto start = input_of(drive, j, x, u[j]);
        auto modes = drive.modes_at(start);
        for (int round = 0; round <= 2 * drive.modes; ++round) {
          tables_.set_modes(j, resize_modes<Tables::M>(modes));
          const auto required =
              drive.required_mode(start, tables_.compute_end_state(drive, j, start), modes);
          if (required == modes) return;
          modes = required;
        }
      }
    });
    tables_.write_modes(in);
  }

  // Eq. (4) with the motors at sample k + 1.
  ARM_INLINE void compute_accelerations(const State<S, X>& x, const X (&u)[row], Dynamics& links,
                                        X (&a)[row]) {
    for_each<N>([&](auto j) __attribute__((always_inline)) {
      links.M.at[j][j] += n_.carried(j);
      a[j] -= links.nle[j];
    });
    coulomb_.set_friction(x, x, u, tables_.modes());
    coulomb_.solve(links.M.at, x.v, a);
  }

  ARM_INLINE void integrate(State<S, X>& x, const X (&a)[row]) const {
    for_each<N>([&](auto j) __attribute__((always_inline)) {
      x.q[j] = fma(h_, x.v[j], x.q[j]);
      x.v[j] = fma(h_, a[j], x.v[j]);
    });
    coulomb_.stop_reversed(x.v);
  }

  Real h_;
  const Numbers<S, X>& n_;
  Tables tables_;
  Coulomb<S, X> coulomb_;
};

struct Paper : AnyScheme {
  static constexpr double end_of_step = 0.0;
  template <class S, class X>
  using Method = PaperScheme<S, X>;
};

}  // namespace arm
