// The modes of a machine (modes.hpp), stored from step to step: most steps begin in the modes in
// which the one before has ended.
//
// This check costs little. The end of a step finds the torques of the locks anyway. Drives that are
// surely in their regular modes (mode.hpp) need no further check. The modes are those that each
// step would determine by itself.
#pragma once

#include "mechanics/modes.hpp"

namespace arm {

template <class S>
class StoredModes {
 public:
  static constexpr int N = S::N;

  explicit StoredModes(const Numbers<S>& numbers) : n_(numbers), modes_(numbers, {}) {}

  const Modes<S>& modes() const { return modes_; }
  // Whether all links rest.
  bool are_links_at_rest() const { return rest_; }
  // State or numbers may have changed since the end of the last step.
  void invalidate() { is_current_ = false; }
  // The end of a step, with the states that its modes hold, calls for these modes.
  ARM_APART void set(const Modes<S>& modes) {
    modes_ = modes;
    rest_ = modes_.friction.are_all_locked(), locks_ = modes_.friction.has_locked();
    n_.for_each_drive([&](const auto& drive, int j) {
      regular_[j] = modes_.drive[j] == DriveModes<Modes<S>::M>{} && drive.is_ever_regular() &&
                    !drive.has_algebraic_state();
    });
    is_current_ = true, is_certain_ = false;
  }

  // Become those of x, the start of a step, with the states that its modes hold. Returns whether
  // they have stayed.
  ARM_INLINE bool begin_step(const State<S>& x, const Real* u, LinksMemo<S>& memo) {
    if (is_current_ && (is_certain_under(u) || are_modes_unchanged(x, u))) return true;
    set(Modes<S>(n_, x, u, memo.find_at(n_, x)));
    return false;
  }
  // Whether they hold at the end y of a step; y then has the states that they hold.
  ARM_INLINE bool end_step(State<S>& y, const Real* u, LinksMemo<S>& memo) {
    is_current_ = false;
    const Drives unsure = find_uncertain_drives(y, u);
    if (unsure.any && !are_drives_within_modes(unsure, y, u)) return false;
    Friction coulomb(n_);
    if constexpr (Friction::present) {
      for (int j = 0; j < N; ++j)
        if (y.v[j] * modes_.friction.direction[j] < 0.0) return false;
      if (locks_) modes_.find_lock_torques(y, u, memo.find_at(n_, y), coulomb);
      for (int j = 0; j < N; ++j)
        if (modes_.friction.locked[j] && coulomb.lock_margin(j) < 0.0) return false;
    }
    is_certain_ = !unsure.any;
    for (int j = 0; j < N; ++j) u_[j] = u[j];
    is_current_ = is_certain_ || is_state_enforced(unsure, y, u);
    if constexpr (Friction::present)
      is_current_ = is_current_ && coulomb.is_confirmed(modes_.friction, y.v);
    return true;
  }

 private:
  using Friction = typename Modes<S>::Friction;

  struct Drives {
    bool any = false, at[N] = {};
  };
  // The drives of which it is not sure that they are in their regular modes and stay there.
  ARM_INLINE Drives find_uncertain_drives(const State<S>& x, const Real* u) const {
    Drives unsure;
    n_.for_each_drive([&](const auto& drive, int j) __attribute__((always_inline)) {
      const auto at = input_of(drive, j, x, u[j]);
      unsure.any |= unsure.at[j] = !(regular_[j] & drive.is_regular_if_ever(at));
    });
    return unsure;
  }
  // Whether holds(drive, its inputs, its modes) of all these drives.
  template <class Holds>
  ARM_APART bool holds_for_each(const Drives& of, const State<S>& x, const Real* u,
                                Holds&& holds) const {
    bool all = true;
    n_.for_each_drive([&](const auto& drive, int j) {
      if (of.at[j])
        all = all && holds(drive, j, input_of(drive, j, x, u[j]), modes_.drive_modes(drive, j));
    });
    return all;
  }
  // Whether the end of the last step was sure of all drives, under the same commands.
  ARM_INLINE bool is_certain_under(const Real* u) const {
    bool sure = is_certain_;
    for (int j = 0; j < N; ++j) sure &= u[j] == u_[j];
    return sure;
  }
  // Whether the drives are called into their modes again. An algebraic state follows commands, and
  // with it friction does.
  ARM_INLINE bool are_modes_unchanged(const State<S>& x, const Real* u) const {
    const Drives unsure = find_uncertain_drives(x, u);
    return !unsure.any ||
           holds_for_each(unsure, x, u,
                          [](const auto& drive, int, const auto& at, const auto& now) {
                            return !drive.has_algebraic_state() && drive.modes_at(at) == now;
                          });
  }
  bool are_drives_within_modes(const Drives& unsure, const State<S>& y, const Real* u) const {
    return holds_for_each(unsure, y, u,
                          [](const auto& drive, int, const auto& at, const auto& now) {
                            return !(drive.margin(at, now) < 0.0);
                          });
  }
  bool is_state_enforced(const Drives& unsure, State<S>& y, const Real* u) const {
    bool same = true;
    holds_for_each(unsure, y, u,
                   [&]<class Drive>(const Drive& drive, int j, auto at, const auto& now) {
                     drive.enforce_modes(at, now);
                     drive.set_algebraic_state(at);
                     for (int k = 0; k < Drive::states; ++k) same = same && at.z[k] == y.z[k][j];
                     store_states(drive, j, 0, at, y);
                     return true;
                   });
    return same;
  }

  const Numbers<S>& n_;
  Modes<S> modes_;
  bool is_current_ = false;  // the end of the last step calls for them again
  bool is_certain_ = false;  // as is_certain_under has it, under u_
  Real u_[N] = {};
  bool rest_ = false, locks_ = false;
  bool regular_[N] = {};  // drives in their regular modes, whose states are not algebraic
};

}  // namespace arm
