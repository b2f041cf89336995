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

  // Become those of the settled state x, the start of a step. Returns whether they are kept.
  ARM_INLINE bool begin(const State<S>& x, const Real* u, LinksMemo<S>& memo) {
    if (stay_ && are_called_for(x, u)) return true;
    determine(x, u, memo);
    return false;
  }
  // Whether they hold at the end y of a step, which is settled then.
  ARM_INLINE bool end(State<S>& y, const Real* u, LinksMemo<S>& memo) {
    stay_ = false;
    const bool sure = are_surely_regular(y, u);
    if (!sure && !drives_hold(y, u)) return false;
    Friction coulomb(n_);
    if constexpr (Friction::present) {
      for (int j = 0; j < N; ++j)
        if (y.v[j] * modes_.friction.direction[j] < 0.0) return false;
      if (locks_) modes_.hold(y, u, memo.at(n_, y), coulomb);
      for (int j = 0; j < N; ++j)
        if (modes_.friction.locked[j] && coulomb.spare(j) < 0.0) return false;
    }
    stay_ = sure || settles_nothing(y, u);
    if constexpr (Friction::present) stay_ = stay_ && coulomb.confirms(modes_.friction, y.v);
    return true;
  }

 private:
  using Friction = typename Modes<S>::Friction;

  ARM_APART void determine(const State<S>& x, const Real* u, LinksMemo<S>& memo) {
    modes_ = Modes<S>(n_, x, u, memo.at(n_, x));
    rest_ = modes_.friction.rest(), locks_ = modes_.friction.lock();
    for (int j = 0; j < N; ++j) regular_[j] = modes_.drive[j] == DriveModes<Modes<S>::M>{};
  }

  // Whether the drive of joint j is in its regular modes, and surely stays there.
  template <class Drive>
  ARM_INLINE bool is_sure(const Drive& drive, int j, const State<S>& x, const Real* u) const {
    if constexpr (Drive::may_follow)
      if (drive.follows_at_once()) return false;
    return regular_[j] && drive.is_regular(input_of(drive, j, x, u[j]));
  }
  ARM_INLINE bool are_surely_regular(const State<S>& x, const Real* u) const {
    bool sure = true;
    n_.for_each_drive([&](const auto& drive, int j)
                          __attribute__((always_inline)) { sure &= is_sure(drive, j, x, u); });
    return sure;
  }
  // Whether the drives are called into their modes again. An algebraic state follows commands, and
  // with it friction does.
  ARM_INLINE bool are_called_for(const State<S>& x, const Real* u) const {
    return are_surely_regular(x, u) || each(x, u, [&](const auto& drive, int j, const auto& at) {
             return !drive.follows_at_once() && drive.modes_at(at) == modes_.of(drive, j);
           });
  }
  bool drives_hold(const State<S>& y, const Real* u) const {
    return each(y, u, [&]<class Drive>(const Drive& drive, int j, const auto& at) {
      if constexpr (Drive::modes > 0) return !(drive.margin(at, modes_.of(drive, j)) < 0.0);
      return true;
    });
  }
  // Whether holds(drive, j, its inputs) of all drives that are not surely regular.
  template <class Holds>
  ARM_APART bool each(const State<S>& x, const Real* u, Holds&& holds) const {
    bool all = true;
    n_.for_each_drive([&](const auto& drive, int j) {
      all = all && (is_sure(drive, j, x, u) || holds(drive, j, input_of(drive, j, x, u[j])));
    });
    return all;
  }
  ARM_APART bool settles_nothing(State<S>& y, const Real* u) const {
    const State<S> before = y;
    modes_.settle(y, u);
    bool same = true;
    for (int j = 0; j < N; ++j) {
      for (int k = 0; k < State<S>::K; ++k) same = same && y.z[k][j] == before.z[k][j];
      same = same && y.v[j] == before.v[j];
    }
    return same;
  }

  const Numbers<S>& n_;
  Modes<S> modes_;
  bool stay_ = false;  // the end of the last step calls for them again
  bool rest_ = false, locks_ = false;
  bool regular_[N] = {};  // drives in their regular modes
};

}  // namespace arm
