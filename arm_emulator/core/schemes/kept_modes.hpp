// The modes of a machine (modes.hpp), kept from step to step: most steps begin in the modes in
// which the one before has ended.
//
// Whether they do is seen at little cost: the end of a step finds the torques of the locks anyway,
// and drives that are surely in their regular modes (mode.hpp) need no closer look. The modes are
// those that each step would determine by itself.
#pragma once

#include "mechanics/modes.hpp"

namespace arm {

template <class S>
class KeptModes {
 public:
  static constexpr int N = S::N;

  explicit KeptModes(const Numbers<S>& numbers) : n_(numbers), modes_(numbers, {}) {}

  const Modes<S>& now() const { return modes_; }
  // Whether all links rest.
  bool rest() const { return rest_; }
  // State or numbers may have changed since the end of the last step.
  void forget() { stay_ = false; }
  // The settled end of a step calls for these modes.
  ARM_APART void take(const Modes<S>& modes) {
    modes_ = modes;
    rest_ = modes_.friction.rest(), locks_ = modes_.friction.lock();
    n_.for_each_drive([&](const auto& drive, int j) {
      regular_[j] = modes_.drive[j] == DriveModes<Modes<S>::M>{} && drive.is_ever_regular() &&
                    !drive.follows_at_once();
    });
    stay_ = true, sure_ = false;
  }

  // Become those of the settled state x, the start of a step. Returns whether they are kept.
  ARM_INLINE bool begin(const State<S>& x, const Real* u, LinksMemo<S>& memo) {
    if (stay_ && (is_sure_under(u) || are_called_for(x, u))) return true;
    take(Modes<S>(n_, x, u, memo.at(n_, x)));
    return false;
  }
  // Whether they hold at the end y of a step, which is settled then.
  ARM_INLINE bool end(State<S>& y, const Real* u, LinksMemo<S>& memo) {
    stay_ = false;
    const Drives unsure = unsure_drives(y, u);
    if (unsure.any && !drives_hold(unsure, y, u)) return false;
    Friction coulomb(n_);
    if constexpr (Friction::present) {
      for (int j = 0; j < N; ++j)
        if (y.v[j] * modes_.friction.direction[j] < 0.0) return false;
      if (locks_) modes_.hold(y, u, memo.at(n_, y), coulomb);
      for (int j = 0; j < N; ++j)
        if (modes_.friction.locked[j] && coulomb.spare(j) < 0.0) return false;
    }
    sure_ = !unsure.any;
    for (int j = 0; j < N; ++j) u_[j] = u[j];
    stay_ = sure_ || settle_changes_nothing(unsure, y, u);
    if constexpr (Friction::present) stay_ = stay_ && coulomb.confirms(modes_.friction, y.v);
    return true;
  }

 private:
  using Friction = typename Modes<S>::Friction;

  struct Drives {
    bool any = false, at[N] = {};
  };
  // The drives of which it is not sure that they are in their regular modes and stay there.
  ARM_INLINE Drives unsure_drives(const State<S>& x, const Real* u) const {
    Drives unsure;
    n_.for_each_drive([&](const auto& drive, int j) __attribute__((always_inline)) {
      const auto at = input_of(drive, j, x, u[j]);
      unsure.any |= unsure.at[j] = !(regular_[j] & drive.is_regular_where_ever(at));
    });
    return unsure;
  }
  // Whether holds(drive, its inputs, its modes) of all these drives.
  template <class Holds>
  ARM_APART bool each(const Drives& of, const State<S>& x, const Real* u, Holds&& holds) const {
    bool all = true;
    n_.for_each_drive([&](const auto& drive, int j) {
      if (of.at[j]) all = all && holds(drive, j, input_of(drive, j, x, u[j]), modes_.of(drive, j));
    });
    return all;
  }
  // Whether the end of the last step was sure of all drives, under the same commands.
  ARM_INLINE bool is_sure_under(const Real* u) const {
    bool sure = sure_;
    for (int j = 0; j < N; ++j) sure &= u[j] == u_[j];
    return sure;
  }
  // Whether the drives are called into their modes again. An algebraic state follows commands, and
  // with it friction does.
  ARM_INLINE bool are_called_for(const State<S>& x, const Real* u) const {
    const Drives unsure = unsure_drives(x, u);
    return !unsure.any ||
           each(unsure, x, u, [](const auto& drive, int, const auto& at, const auto& now) {
             return !drive.follows_at_once() && drive.modes_at(at) == now;
           });
  }
  bool drives_hold(const Drives& unsure, const State<S>& y, const Real* u) const {
    return each(unsure, y, u, [](const auto& drive, int, const auto& at, const auto& now) {
      return !(drive.margin(at, now) < 0.0);
    });
  }
  bool settle_changes_nothing(const Drives& unsure, State<S>& y, const Real* u) const {
    bool same = true;
    each(unsure, y, u, [&]<class Drive>(const Drive& drive, int j, auto at, const auto& now) {
      drive.settle(at, now);
      drive.follow(at);
      for (int k = 0; k < Drive::states; ++k) same = same && at.z[k] == y.z[k][j];
      put_states(drive, j, 0, at, y);
      return true;
    });
    return same;
  }

  const Numbers<S>& n_;
  Modes<S> modes_;
  bool stay_ = false;  // the end of the last step calls for them again
  bool sure_ = false;  // as is_sure_under has it, under u_
  Real u_[N] = {};
  bool rest_ = false, locks_ = false;
  bool regular_[N] = {};  // drives in their regular modes, whose states are not algebraic
};

}  // namespace arm
