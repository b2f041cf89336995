// Coulomb friction at the links, and the equations of motion solved with it.
//
// The torque on a sliding joint is -Dc sign(v). A joint at rest is locked while the holding torque
// is at most its breakaway torque Ds >= Dc; else it starts to slide that way. Both torques may be 0
// for an instant (load friction): the joint is then free. A joint whose speed would change sign
// within a step stops at the step's end. A joint at rest stays at rest exactly, without
// regularisation and at any step size. The instants of stopping and starting are known to one step,
// and the scheme's order there is 1 (2 in event_location.hpp).
//
// Locked joints are coupled: a descent decides which of them break away. W is positive definite.
// The accelerations x therefore minimise x W x / 2 - rhs x + sum of Dc |x|, with Dc for joints that
// have broken away. Each round lowers this sum: it frees the most overloaded joint, and locks a
// joint
// that would reverse. Hence the rounds are finite, and the result is consistent for all joints.
#pragma once

#include "mechanics/numbers.hpp"
#include "mechanics/state.hpp"

namespace arm {

template <class S, class X>
class Coulomb {
 public:
  static constexpr int N = S::N;
  using Matrix = Symmetric<N, X>;

  static constexpr bool present = any_drive<S>([](const auto& drive) { return drive.is_dry(); });
  // Whether the sliding torque varies: then it is that of the state last taken.
  static constexpr bool varies =
      any_drive<S>([](const auto& drive) { return drive.friction_varies; });
  // Whether the breakaway torque depends on a load.
  static constexpr bool loaded =
      any_drive<S>([](const auto& drive) { return drive.holds_by_load; });
  // Whether friction is another one in the other direction.
  static constexpr bool directed =
      any_drive<S>([](const auto& drive) { return drive.friction_is_directed; });

  explicit Coulomb(const Numbers<S, X>& numbers) : n_(numbers) {}

  // Take the friction at x, in the drives' modes(drive, j, lane), and breakaway torques at
  // `load_state`, the state of the torque on the joint.
  template <class ModesOf>
  void set_friction([[maybe_unused]] const State<S, X>& x,
                    [[maybe_unused]] const State<S, X>& load_state, [[maybe_unused]] const X* u,
                    [[maybe_unused]] const ModesOf& modes) {
    if constexpr (varies) {
      for (int lane = 0; lane < kWidth<X>; ++lane)
        n_.for_each_drive_of(lane, [&](const auto& drive, int j) {
          const auto now = modes(drive, j, lane);
          const auto at = [&](const State<S, X>& state) {
            return drive.apply_modes(input_in_lane(drive, j, state, u[j], lane), now);
          };
          const Real v = lane_of(x.v[j], lane);
          for (int side = 0; side < FrictionTorques::sides; ++side) {
            // One that slides does so in one direction, and nothing holds it.
            const bool slides = directed && v != 0.0;
            if (slides && side == 1) {
              set_lane(torques_.Dc[1][j], lane, lane_of(torques_.Dc[0][j], lane));
              break;
            }
            const Real sign = slides ? sign_of(v) : side == 0 ? Real{1.0} : Real{-1.0};
            set_lane(torques_.Dc[side][j], lane, drive.sliding_torque(at(x), now.active(), sign));
            if (!slides)
              set_lane(torques_.Ds[side][j], lane,
                       drive.holding_torque(at(load_state), now.active(), sign));
          }
          set_lane(torques_.dry[j], lane, drive.is_dry());
        });
    }
  }
  // Friction at y less that taken, against the motion of joint j [N m].
  template <class ModesOf>
  void add_change(const State<S, X>& y, const X* u, const ModesOf& modes, X* change) const {
    for (int lane = 0; lane < kWidth<X>; ++lane)
      n_.for_each_drive_of(lane, [&](const auto& drive, int j) {
        if (!drive.friction_varies ||
            lane_of(X{} + select(locked_[j], X{} + 1.0, X{}), lane) != 0.0)
          return;
        const auto now = modes(drive, j, lane);
        const auto at = drive.apply_modes(input_in_lane(drive, j, y, u[j], lane), now);
        const Real sign = lane_of(direction_[j], lane);
        const Real more =
            drive.sliding_torque(at, now.active(), sign) - lane_of(Dc(j, direction_[j]), lane);
        set_lane(change[j], lane, lane_of(change[j], lane) - more * sign);
      });
  }

  // Decide what each joint does in this step, for W x = rhs, and solve for x. The factors and the
  // decisions serve `solve_again` for a second right-hand side of the same step.
  ARM_INLINE void solve(Matrix& W, const X* v, X* x) {
    if constexpr (!present) {
      factors_.factor(W);
      factors_.solve(x);
    } else {
      set_modes(v);
      all_at_rest_ = all(are_all_holding(x));
      if (all_at_rest_) {
        for (int j = 0; j < N; ++j) lock_torque_[j] = x[j], x[j] = X{};
        return;
      }
      Descent down;
      for (int j = 0; j < N; ++j) down.rhs[j] = x[j];
      do {
        factor_unlocked(W);
        for (int j = 0; j < N; ++j) x[j] = down.rhs[j] - sliding_torque(j);
        solve_again(x);
      } while (lock_joint(down, x) || free_joint(W, down, x));
    }
  }

  // The decisions alone. Joints that all slide, or all rest, need no solution for them, nor `mass`,
  // which gives W.
  void decide(auto&& mass, const X* v, X* rhs) {
    set_modes(v);
    Mask<X> slide = X{} == X{};
    for (int j = 0; j < N; ++j) {
      lock_torque_[j] = rhs[j];
      slide &= invert_mask(locked_[j]);
    }
    if (all(slide | are_all_holding(rhs))) return;
    auto M = mass();
    solve_apart(M.at, v, rhs);
  }
  // `solve`, not inlined, for rare calls.
  ARM_APART void solve_apart(Matrix& W, const X* v, X* x) { solve(W, v, x); }

  // Mode of each joint: locked, or the direction in which it slides, which is 0 without dry
  // friction.
  struct Modes {
    Mask<X> locked[N] = {};
    X direction[N] = {};

    // Whether any joint is locked.
    bool has_locked() const {
      Mask<X> result = {};
      for (const Mask<X>& mask : locked) result |= mask;
      return any(result);
    }
    // Whether all joints are locked.
    bool are_all_locked() const {
      Mask<X> result = X{} == X{};
      for (const Mask<X>& mask : locked) result &= mask;
      return all(result);
    }
  };
  Modes modes() const {
    Modes modes;
    for (int j = 0; j < N; ++j) modes.locked[j] = locked_[j], modes.direction[j] = direction_[j];
    return modes;
  }

  // Solve for x with the modes fixed, whatever torque they take. W may be used up.
  void solve_in(const Modes& modes, Matrix& W, X* x) {
    all_at_rest_ = false;
    X rhs[N];
    for (int j = 0; j < N; ++j) {
      locked_[j] = modes.locked[j], direction_[j] = modes.direction[j];
      rhs[j] = x[j];
    }
    const bool lock = modes.has_locked();
    if constexpr (kWidth<X> == 1)
      if (!lock) {
        factors_.factor(W);
        for (int j = 0; j < N; ++j) x[j] = rhs[j] - sliding_torque(j);
        return factors_.solve(x);
      }
    if (lock)
      factor_unlocked(W);
    else
      factor(W);
    for (int j = 0; j < N; ++j) x[j] = rhs[j] - sliding_torque(j);
    solve_again(x);
    if (lock) set_lock_torques(W, rhs, x);
  }
  // The torques of locks alone, with the modes fixed.
  void find_lock_torques(const Modes& modes, auto&& mass, X* x) {
    if (!modes.are_all_locked()) {
      auto M = mass();
      return solve_in(modes, M.at, x);
    }
    for (int j = 0; j < N; ++j) lock_torque_[j] = x[j];
  }

  // Whether `decide` finds these modes again at the state of the newest `find_lock_torques` with
  // them, of which v are the speeds. The state alone decides, not the commands.
  bool is_confirmed(const Modes& modes, const X* v) const {
    Mask<X> same = X{} == X{};
    for (int j = 0; j < N; ++j) {
      const auto& locked = modes.locked[j];
      const X sign = modes.direction[j];
      const auto holds =
          (v[j] == 0.0) & invert_mask(magnitude(lock_torque_[j]) > Ds(j, lock_torque_[j]));
      same &=
          where(locked, holds) | where(invert_mask(locked), (sign == 0.0) | (v[j] * sign > 0.0));
    }
    return all(same);
  }

  // Remaining capacity of the lock of joint j, below 0 if it does not hold [N m].
  ARM_INLINE X lock_margin(int j) const {
    return Ds(j, lock_torque_[j]) * (1.0 + kRounding) - magnitude(lock_torque_[j]);
  }

  ARM_INLINE void solve_again(X* x) const {
    if constexpr (present && skips_locked) return factors_.solve(x, is_locked());
    if constexpr (present)
      for (int j = 0; j < N; ++j) x[j] = select(locked_[j], X{}, x[j]);
    if (!all_at_rest_) factors_.solve(x);
  }

  // Torque against the motion of joint j, or of the lock that holds it.
  ARM_INLINE X force(int j) const {
    if constexpr (present)
      return select(locked_[j], lock_torque_[j], sliding_torque(j));
    else
      return X{};
  }

  // Stop the joints whose speed has changed sign.
  ARM_INLINE void stop_reversed(X* v) const {
    if constexpr (present)
      for (int j = 0; j < N; ++j)
        v[j] = select(where(is_dry(j), v[j] * direction_[j] <= 0.0), X{}, v[j]);
  }

 private:
  // Set the modes for the speeds v, with every joint at rest locked.
  ARM_INLINE void set_modes(const X* v) {
    for (int j = 0; j < N; ++j) {
      direction_[j] = select(where(is_dry(j), v[j] > 0.0), X{} + 1.0,
                             select(where(is_dry(j), v[j] < 0.0), X{} - 1.0, X{}));
      locked_[j] = where(is_dry(j), v[j] == 0.0);
    }
  }

  // Whether factors leave out the locked joints.
  static constexpr bool skips_locked = std::is_same_v<X, double> && MassPattern<S>::from_the_tip;
  auto is_locked() const {
    return [this](int j) __attribute__((always_inline)) { return locked_[j]; };
  }
  // Whether all joints are locked and hold under these torques.
  Mask<X> are_all_holding(const X* torque) const {
    Mask<X> rest = X{} == X{};
    for (int j = 0; j < N; ++j)
      rest &= where(locked_[j], invert_mask(magnitude(torque[j]) > Ds(j, torque[j])));
    return rest;
  }

  // M with the rows and columns of the locked joints made those of the identity.
  void factor_unlocked(const Matrix& W) {
    if constexpr (skips_locked) return factors_.factor(W, is_locked());
    Matrix free = {};
    for (int j = 0; j < N; ++j)
      for (int k = j; k < N; ++k)
        free[j][k] = select(locked_[j] | locked_[k], X{} + (j == k ? 1.0 : 0.0), W[j][k]);
    factor(free);
  }
  // Lanes without a locked joint get the same bits beside one that has one, and without.
  ARM_INLINE void factor(Matrix& W) {
    if constexpr (kWidth<X> == 1)
      factors_.factor(W);
    else
      factor_apart(W);
  }
  ARM_APART void factor_apart(Matrix& W) { factors_.factor(W); }

  // Put the torques of the locks under which the joints accelerate by x.
  ARM_INLINE void set_lock_torques(const Matrix& W, const X* rhs, const X* x) {
    X torque[N];
    for (int j = 0; j < N; ++j) torque[j] = rhs[j];
    for (int k = 0; k < N; ++k) {
      if constexpr (skips_locked)
        if (locked_[k]) continue;  // and x[k] is 0
      for (int j = 0; j < N; ++j) torque[j] = fma(-(k >= j ? W[j][k] : W[k][j]), x[k], torque[j]);
    }
    for (int j = 0; j < N; ++j) lock_torque_[j] = select(locked_[j], torque[j], lock_torque_[j]);
  }

  // Progress of the search for consistent modes.
  struct Descent {
    X rhs[N];
    Mask<X> broken[N] = {};  // away, in this step: they are held by Dc
    X x[N] = {};             // their accelerations, none against its joint's direction
    int rounds = 0;          // rounds that have freed joints
  };
  static constexpr int kMaxRounds = 4 * N;  // rounding might prevent an end

  // If joints that have broken away would move backward: lock the first that comes to rest between
  // the previous point of the descent and x; false if none would. In lanes without such a joint the
  // descent reaches x.
  bool lock_joint(Descent& down, const X* x) {
    if (down.rounds == 0) return false;
    X part = X{} + 1.0, first = X{} - 1.0;
    for (int j = 0; j < N; ++j) {
      const auto back = where(down.broken[j], x[j] * direction_[j] < 0.0);
      const X along = select(back, down.x[j] / select(back, down.x[j] - x[j], X{} + 1.0), part);
      const auto sooner = where(back, along < part);
      first = select(sooner, X{} + j, first);
      part = select(sooner, along, part);
    }
    for (int j = 0; j < N; ++j) {
      const auto stops = first == static_cast<Real>(j);
      const X there = down.x[j] + part * (x[j] - down.x[j]);
      down.x[j] = select(stops, X{}, select(down.broken[j], there, X{}));
      direction_[j] = select(stops, X{}, direction_[j]);
      locked_[j] = locked_[j] | as_mask(stops);
    }
    return any(first >= 0.0);
  }

  // Free the joint that is the most overloaded; false if every locked joint holds.
  bool free_joint(const Matrix& W, Descent& down, const X* x) {
    X excess = {}, sign = {}, worst = X{} - 1.0;
    set_lock_torques(W, down.rhs, x);
    for (int j = 0; j < N; ++j) {
      const X torque = lock_torque_[j];
      const X capacity = select(down.broken[j], X{} + Dc(j, torque), X{} + Ds(j, torque));
      const X over = select(locked_[j], magnitude(torque) - capacity, X{});
      const auto more = over > excess;
      worst = select(more, X{} + j, worst);
      excess = select(more, over, excess);
      sign = select(more, select(torque < 0.0, X{} - 1.0, X{} + 1.0), sign);
    }
    if (!any(worst >= 0.0) || down.rounds++ == kMaxRounds) return false;
    for (int j = 0; j < N; ++j) {
      const auto freed = worst == static_cast<Real>(j);
      locked_[j] = locked_[j] & ~as_mask(freed);
      down.broken[j] = down.broken[j] | as_mask(freed);
      direction_[j] = select(freed, sign, direction_[j]);
    }
    return true;
  }

  ARM_INLINE static Mask<X> invert_mask(const Mask<X>& mask) {
    if constexpr (kWidth<X> == 1)
      return !mask;
    else
      return ~mask;
  }
  // ~ of a bool is not its opposite.
  ARM_INLINE static int as_mask(bool mask) { return mask ? -1 : 0; }
  template <class M>
  ARM_INLINE static const M& as_mask(const M& mask) {
    return mask;
  }

  // Friction torques of a step, if they vary.
  struct FrictionTorques {
    static constexpr int sides = directed ? 2 : 1;  // forward, and backward if that differs
    X Dc[sides][N] = {}, Ds[sides][N] = {};
    X dry[N] = {};  // 1 where there is a law of dry friction, be its torques 0 just then
  };

  // Friction of joint j that slides, or is pulled, in the direction of `sign`.
  ARM_INLINE auto Dc(int j, [[maybe_unused]] const X& sign) const {
    if constexpr (directed)
      return select(sign < 0.0, torques_.Dc[1][j], torques_.Dc[0][j]);
    else if constexpr (varies)
      return torques_.Dc[0][j];
    else
      return n_.Dc(j);
  }
  ARM_INLINE auto Ds(int j, [[maybe_unused]] const X& sign) const {
    if constexpr (directed)
      return select(sign < 0.0, torques_.Ds[1][j], torques_.Ds[0][j]);
    else if constexpr (varies)
      return torques_.Ds[0][j];
    else
      return n_.Ds(j);
  }
  ARM_INLINE auto sliding_torque(int j) const { return Dc(j, direction_[j]) * direction_[j]; }

  // Whether a joint may be locked: whether it has a law of dry friction.
  ARM_INLINE auto is_dry(int j) const {
    if constexpr (varies)
      return torques_.dry[j] > 0.0;
    else
      return n_.Dc(j) > 0.0;
  }

  const Numbers<S, X>& n_;
  [[no_unique_address]] std::conditional_t<varies, FrictionTorques, Nothing> torques_;
  MassFactors<S, X> factors_;
  Mask<X> locked_[N] = {};
  X direction_[N] = {};
  X lock_torque_[N] = {};     // torque of a lock [N m]
  bool all_at_rest_ = false;  // all rest in this step, which has no factors
};

}  // namespace arm
