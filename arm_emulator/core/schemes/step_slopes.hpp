// The derivatives of a step, or a part of it, of a linearly implicit scheme with two stages, by
// all directions at once: what costs the most is done once for all of them.
//
// The drives' part of a step (drive_steps.hpp) is taken with numbers whose directions are the
// inputs of one joint: its states z, q, v, and the link's accelerations k1 and k2 in both stages.
// No drive depends on another joint, so the directions are the same for all joints. The results are
// the rows of a small matrix per joint. The links' part has derivatives by q and v
// (link_slopes.hpp).
// With d for the change along a direction, the stages of linearly_implicit.hpp are then
//
//   W dk1 = first (dz, dq, dv) - (dM k1 + dnle)                     W = M + carried + diagonal
//   W dk2 = second (dz, dq, dv, dk1) - dM k2 - sqrt(2) dnle + change of the links
//
// of which W is factored once. Numbers that change along a direction add their effect at a fixed
// state (OwnSlopes), in the joints that they belong to.
#pragma once

#include "mechanics/links/link_slopes.hpp"
#include "schemes/drive_steps.hpp"
#include "schemes/scheme.hpp"

namespace arm {

// Derivatives in all directions, aligned as the processor likes it.
inline constexpr int kDirections = sizeof(Real::Row) / sizeof(double);
using Directions = Lanes<kDirections>;

// The share of those of a machine's numbers that change along the directions, at a state that does
// not change.
template <class S>
struct OwnSlopes {
  using Row = Directions;
  static constexpr int N = S::N, K = max_states<S>();
  bool at[N] = {}, links = false;  // joints whose drives have such numbers, and whether links have
  Row first[N], second[N], z[K > 0 ? K : 1][N], carried[N], diagonal[N];
  Row links_first[N], links_second[N];

  bool any() const {
    bool result = links;
    for (const bool flag : at) result = result || flag;
    return result;
  }
};

// `from_past`: with the change of the links' torques from the step before.
template <class S, class Method, bool from_past>
class StepSlopes {
 public:
  using Memory = typename Method::Memory;
  using Row = Directions;
  using Own = OwnSlopes<S>;
  static constexpr int N = S::N, K = State<S>::K, row = Method::row;

  // Take those of the step of `method` from x on, all without derivatives; `modes_at` gives the
  // modes at a state.
  void update(Method& method, const Numbers<S>& n, const LinkSlopes<S>& links, const State<S>& x,
              const Real (&u)[row], const Memory& past, double h, auto&& modes_at) {
    for (int from = 0; from < inputs; from += width) {
      State<S> y = x;
      const auto seed = [from](Real& number, int input) {
        if (input >= from && input < from + width) number.by[input - from] = 1.0;
      };
      for (int j = 0; j < N; ++j) {
        for (int k = 0; k < K; ++k) seed(y.z[k][j], k);
        seed(y.q[j], q), seed(y.v[j], v);
      }
      const Modes<S> modes = modes_at(y);
      const auto keep = [from](const Real& number, double (&of)[inputs]) {
        for (int d = 0; d < width && from + d < inputs; ++d) of[from + d] = number.by[d];
      };
      for (int j = 0; j < N; ++j) set_modes(method, j, modes, h);
      const Steps steps(method.tables(), n, modes.friction);
      if constexpr (kHasStartStates<S>) set_start_states(n, y, u);
      typename Steps::Inputs in[N];
      Real puts[N];
      steps.for_each_joint([&](const auto& drive, const auto& linear, int j) {
        puts[j] = steps.compute_first_rhs(drive, linear, j, y, u[j], in[j]);
        keep(puts[j], first_[j]);
      });
      if (from == 0) solve_first(method, n, links, modes, puts);
      steps.for_each_joint([&](const auto& drive, const auto& linear, int j) {
        Real a = k1_[j];
        seed(a, k1);
        puts[j] = steps.compute_second_rhs(drive, linear, j, h, a, in[j]);
        keep(puts[j], second_[j]);
      });
      if (from == 0) solve_second(n, links, x, past, h, puts);
      for (int j = 0; j < N; ++j) {
        Real a = k2_[j];
        seed(a, k2);
        for (int k = 0; k < K; ++k) {
          const Real z = steps.compute_end_state(k, j, a, in[j]);
          keep(z, z_[k][j]);
          end_z_[k][j] = z.value;
        }
      }
    }
  }

  // Take what the numbers of `method` and n add.
  void update_own(Method& method, const Numbers<S>& n, const Modes<S>& modes, State<S> x,
                  const Real (&u)[row], double h, Own& own) const {
    for (int j = 0; j < N; ++j)
      if (own.at[j]) set_modes(method, j, modes, h);
    const Steps steps(method.tables(), n, modes.friction);
    if constexpr (kHasStartStates<S>) set_start_states(n, x, u);
    steps.for_each_joint([&](const auto& drive, const auto& linear, int j) {
      if (!own.at[j]) return;
      typename Steps::Inputs in;
      own.first[j] = steps.compute_first_rhs(drive, linear, j, x, u[j], in).by;
      own.second[j] = steps.compute_second_rhs(drive, linear, j, h, k1_[j], in).by;
      for (int k = 0; k < K; ++k) own.z[k][j] = steps.compute_end_state(k, j, k2_[j], in).by;
    });
    update_inertia(method, n, own);
    if (own.links) update_first_links(n, x, own), update_second_links(n, x, own);
  }

  // Move x over the step, and the memory of it.
  void move_state(State<S>& x, Memory& past, const Own& own, double h) const {
    advance(
        x, past, own, h,
        [&](const auto& in, Row(&a)[N]) {
          for (int j = 0; j < N; ++j) {
            a[j] = sum_joint<v + 1>(first_[j], in, j);
            if (own.at[j]) a[j] += own.first[j];
          }
        },
        [&](const auto& in, Row(&a)[N]) {
          for (int j = 0; j < N; ++j) {
            a[j] = sum_joint<k1 + 1>(second_[j], in, j);
            if (own.at[j]) a[j] += own.second[j];
          }
        },
        [&](const auto& in, int k, int j) -> Real {
          Row z = sum_joint<inputs>(z_[k][j], in, j);
          if (own.at[j]) z += own.z[k][j];
          return {end_z_[k][j], z};
        });
  }

  // Move one machine alone, from `start` with the derivatives of x: `method` and `own_n`
  // have those of its numbers.
  void move_single(Method& method, const Numbers<S>& own_n, const Numbers<S>& n,
                   const LinkSlopes<S>& links, const Modes<S>& modes, const State<S>& start,
                   State<S>& x, const Real (&u)[row], Memory& past, Own& own, double h) {
    for (int j = 0; j < N; ++j) set_modes(method, j, modes, h);
    update_inertia(method, own_n, own);
    const Steps steps(method.tables(), own_n, modes.friction);
    if constexpr (kHasStartStates<S>) set_start_states(own_n, x, u);
    typename Steps::Inputs inputs_of[N];
    Real puts[N];
    const auto put = [&puts](Row(&a)[N]) {
      for (int j = 0; j < N; ++j) a[j] = puts[j].by;
    };
    advance(
        x, past, own, h,
        [&](const auto&, Row(&a)[N]) {
          steps.for_each_joint([&](const auto& drive, const auto& linear, int j) {
            puts[j] = steps.compute_first_rhs(drive, linear, j, x, u[j], inputs_of[j]);
          });
          solve_first(method, n, links, modes, puts);
          if (own.links) update_first_links(own_n, start, own);
          put(a);
        },
        [&](const auto& in, Row(&a)[N]) {
          steps.for_each_joint([&](const auto& drive, const auto& linear, int j) {
            puts[j] =
                steps.compute_second_rhs(drive, linear, j, h, {k1_[j], in[k1][j]}, inputs_of[j]);
          });
          solve_second(n, links, start, past, h, puts);
          if (own.links) update_second_links(own_n, start, own);
          put(a);
        },
        [&](const auto& in, int k, int j) {
          return steps.compute_end_state(k, j, {k2_[j], in[k2][j]}, inputs_of[j]);
        });
  }

 private:
  using Tables = typename Method::Drives;
  using Steps = DriveSteps<S, Tables>;
  static constexpr int width = kDirections;
  // The inputs of a joint's part, besides z.
  static constexpr int q = K, v = K + 1, k1 = K + 2, k2 = K + 3, inputs = K + 4;
  using Matrix = double[N][N];

  ARM_INLINE static Row sum_products(const double (&of)[N], const Row* x) {
    Row sum = of[0] * x[0];
    for (int i = 1; i < N; ++i) sum += of[i] * x[i];
    return sum;
  }
  // The common part of move_state and move_single: `first` and `second` give what the drives put on
  // the links, `end` a state of a drive.
  ARM_INLINE void advance(State<S>& x, Memory& past, const Own& own, double h, auto&& first,
                          auto&& second, auto&& end) const {
    constexpr double gamma = find_gamma(2);
    Row in[inputs][N];
    for (int j = 0; j < N; ++j) {
      for (int k = 0; k < K; ++k) in[k][j] = x.z[k][j].by;
      in[q][j] = x.q[j].by, in[v][j] = x.v[j].by;
    }
    Row a[N], torque[N], before[N], torque_before[N];
    first(in, a);
    for (int j = 0; j < N; ++j) {
      if constexpr (from_past) before[j] = past.a[j].by, torque_before[j] = past.torque[j].by;
      torque[j] = sum_products(links_by_q_[j], in[q]) + sum_products(links_by_v_[j], in[v]);
      a[j] -= torque[j];
      if (own.at[j]) a[j] -= k1_[j] * (own.carried[j] + own.diagonal[j]);
      if (own.links) a[j] -= own.links_first[j], torque[j] += own.links_first[j];
    }
    solve(a);
    for (int j = 0; j < N; ++j) {
      in[k1][j] = a[j];
      torque[j] += sum_products(M_[j], a);
      if (own.at[j]) torque[j] += k1_[j] * own.carried[j];
    }
    second(in, a);
    const auto& from = from_past ? torque_before : torque;
    for (int j = 0; j < N; ++j) {
      a[j] += from[j] + sum_products(second_by_q_[j], in[q]) +
              sum_products(second_by_v_[j], in[v]) +
              sum_products(second_by_a_[j], from_past ? before : in[k1]);
      if (own.at[j])
        a[j] -= past_a_[j] * own.carried[j] + k2_[j] * (own.carried[j] + own.diagonal[j]);
      if (own.links) a[j] -= own.links_second[j];
    }
    solve(a);
    for (int j = 0; j < N; ++j) {
      in[k2][j] = a[j];
      if constexpr (from_past)
        past.a[j] = {k1_[j], in[k1][j]}, past.torque[j] = {torque_[j], torque[j]};
      const Real first = {k1_[j], in[k1][j]}, second = {k2_[j], a[j]};
      x.q[j] += h * (x.v[j] + gamma * h * (first + 0.5 * second));
      x.v[j] += h * (gamma * first + 0.5 * second);
      for (int k = 0; k < K; ++k) {
        x.z[k][j] = end(in, k, j);
      }
    }
  }

  template <int end>
  ARM_INLINE static Row sum_joint(const double (&of)[inputs], const Row (&in)[inputs][N], int j) {
    Row sum = of[0] * in[0][j];
    for (int input = 1; input < end; ++input) sum += of[input] * in[input][j];
    return sum;
  }
  static void set_modes(Method& method, int j, const Modes<S>& modes, double h) {
    Tables& tables = method.tables();
    if constexpr (Tables::modal) tables.set_modes(j, modes.drive[j]);
    if constexpr (requires { tables.set_step({h, 2}, j); }) tables.set_step({h, 2}, j);
  }
  static void update_inertia(Method& method, const Numbers<S>& n, Own& own) {
    for (int j = 0; j < N; ++j)
      if (own.at[j])
        own.carried[j] = n.carried(j).by, own.diagonal[j] = method.tables().diagonal[j].by;
  }
  void update_first_links(const Numbers<S>& n, const State<S>& x, Own& own) const {
    typename Links<S>::Dynamics of;
    Links<S>::compute_dynamics_apart(n, x.q, x.v, of);
    for (Row& row : own.links_first) row = Row{};
    add_link_terms(of, k1_, 1.0, own.links_first);
  }
  void update_second_links(const Numbers<S>& n, const State<S>& x, Own& own) const {
    typename Links<S>::Dynamics of;
    Links<S>::compute_dynamics_apart(n, x.q, x.v, of);
    for (Row& row : own.links_second) row = Row{};
    add_link_terms(of, k2_, kSqrt2, own.links_second);
    if constexpr (!from_past) Links<S>::compute_dynamics_apart(n, change_at_.q, change_at_.v, of);
    add_link_terms(of, past_a_, 1.0, own.links_second);
  }
  static void add_link_terms(const auto& of, const double* a, double of_nle, Row (&to)[N]) {
    for (int j = 0; j < N; ++j) {
      to[j] += of_nle * of.nle[j].by;
      for (int k = 0; k < N; ++k) to[j] += a[k] * of.M.entry(j, k).by;
    }
  }
  // W x = rhs, of joints that are not locked.
  template <class Number>
  ARM_INLINE void solve(Number* x) const {
    for (int j = 0; j < N; ++j)
      if (locked_[j]) x[j] = Number{};
    factors_.solve(x);
  }

  void solve_first(Method& method, const Numbers<S>& n, const LinkSlopes<S>& links,
                   const Modes<S>& modes, const Real* numbers) {
    alignas(64) Symmetric<N, double> W = {};
    for (int j = 0; j < N; ++j) locked_[j] = modes.friction.locked[j];
    for (int j = 0; j < N; ++j) {
      for (int k = 0; k < N; ++k) M_[j][k] = links.M(j, k);
      M_[j][j] += n.carried(j).value;
      for (int k = j; k < N; ++k)
        W[j][k] = !(locked_[j] || locked_[k]) ? M_[j][k] : j == k ? 1.0 : 0.0;
      if (!locked_[j]) W[j][j] += method.tables().diagonal[j].value;
      k1_[j] = numbers[j].value - links.nle(j);
    }
    factors_.factor(W);
    solve(k1_);
    for (int j = 0; j < N; ++j) {
      torque_[j] = links.nle(j);
      for (int k = 0; k < N; ++k) torque_[j] += M_[j][k] * k1_[k];
    }
    links.by_q(k1_, 1.0, links_by_q_);
    links.by_v(links_by_v_);
  }
  void solve_second(const Numbers<S>& n, const LinkSlopes<S>& links, const State<S>& x,
                    const Memory& past, double h, const Real* numbers) {
    constexpr double gamma = find_gamma(2);
    [[maybe_unused]] LinkSlopes<S> own;
    const LinkSlopes<S>* at = &links;
    if constexpr (!from_past) {
      change_at_ = x;
      for (int j = 0; j < N; ++j) {
        change_at_.q[j] += h * (x.v[j] + gamma * h * k1_[j]);
        change_at_.v[j] += h * k1_[j];
      }
      own.update(n, change_at_);
      at = &own;
    }
    Matrix by_q = {}, by_v;
    for (int j = 0; j < N; ++j) past_a_[j] = from_past ? past.a[j].value : k1_[j];
    if constexpr (!from_past) at->by_q(past_a_, 1.0, by_q);
    at->by_v(by_v);
    for (int j = 0; j < N; ++j) {
      k2_[j] =
          numbers[j].value - kSqrt2 * links.nle(j) - at->nle(j) - n.carried(j).value * past_a_[j];
      k2_[j] += from_past ? past.torque[j].value : torque_[j];
      for (int k = 0; k < N; ++k) {
        k2_[j] -= at->M(j, k) * past_a_[k];
        second_by_a_[j][k] = -at->M(j, k);
        if (!from_past) second_by_a_[j][k] -= h * (gamma * h * by_q[j][k] + by_v[j][k]);
      }
      second_by_a_[j][j] -= n.carried(j).value;
    }
    solve(k2_);
    // dM k2 + sqrt(2) dnle, with the change at x, too.
    double a[N];
    for (int j = 0; j < N; ++j) a[j] = from_past ? k2_[j] + past_a_[j] : k2_[j];
    links.by_q(a, from_past ? kSqrt2 + 1.0 : kSqrt2, second_by_q_);
    for (int j = 0; j < N; ++j)
      for (int i = 0; i < N; ++i) {
        second_by_q_[j][i] = -second_by_q_[j][i] - by_q[j][i];
        second_by_v_[j][i] = -by_v[j][i] - kSqrt2 * links_by_v_[j][i];
        if (!from_past) second_by_v_[j][i] -= h * by_q[j][i];
      }
  }

  bool locked_[N];
  MassFactors<S, double> factors_;
  // The links' torques M a + nle change from those of the step before to those
  // here, or from here to another state.
  [[no_unique_address]] std::conditional_t<from_past, Nothing, State<S>> change_at_;
  double k1_[N], k2_[N], torque_[N], past_a_[N], end_z_[K > 0 ? K : 1][N];
  Matrix M_, links_by_q_, links_by_v_, second_by_q_, second_by_v_, second_by_a_;
  double first_[N][inputs], second_[N][inputs], z_[K > 0 ? K : 1][N][inputs];
};

}  // namespace arm
