// Modes of the joints at an instant: a link slides or is locked (coulomb.hpp), and each part with
// modes is in one (mode.hpp). They follow from state and commands alone.
#pragma once

#include "mechanics/algebraic_states.hpp"
#include "mechanics/coulomb.hpp"
#include "mechanics/links/links.hpp"
#include "mechanics/links/links_memo.hpp"
#include "mechanics/state.hpp"

namespace arm {

template <class S>
class Modes {
 public:
  static constexpr int N = S::N, M = max_modes<S>();
  using Dynamics = typename Links<S>::Dynamics;
  using Friction = Coulomb<S, Real>;

  // Whether this scene has more than one mode.
  static constexpr bool present = Friction::present || M > 0;

  typename Friction::Modes friction;
  DriveModes<M> drive[N];

  // The modes `of_links`, and the regular modes of all drives.
  Modes(const Numbers<S>& numbers, const typename Friction::Modes& of_links)
      : friction(of_links), n_(&numbers) {}

  // Modes of a state x on which `enforce_modes` has been called, with its links' part.
  Modes(const Numbers<S>& numbers, const State<S>& x, const Real* u, const Dynamics& links)
      : n_(&numbers) {
    n_->for_each_drive([&]<class Drive>(const Drive& drive, int j) {
      if constexpr (Drive::modes > 0)
        this->drive[j] = resize_modes<M>(drive.modes_at(input_of(drive, j, x, u[j])));
    });
    if constexpr (Friction::present) {
      Friction coulomb(*n_);
      Real a[N];
      compute_torques(x, u, links, a);
      coulomb.set_friction(x, x, u, list_drive_modes());
      coulomb.decide([&] { return compute_loaded_inertia(links); }, x.v, a);
      friction = coulomb.modes();
    }
  }

  // Modes of a state x, of which the algebraic states are set first.
  static Modes find_at(const Numbers<S>& numbers, State<S>& x, const Real* u) {
    Dynamics links;
    Links<S>::compute_dynamics_apart(numbers, x.q, x.v, links);
    set_algebraic_states(numbers, x, u);
    return Modes(numbers, x, u, links);
  }

  // Modes of the drive of joint j alone.
  template <class Drive>
  DriveModes<Drive::modes> drive_modes(const Drive&, int j) const {
    return resize_modes<Drive::modes>(drive[j]);
  }

  // The links' accelerations at x.
  void compute_accelerations(const State<S>& x, const Real* u, const Dynamics& links, Real (&a)[N],
                             Friction& coulomb) const {
    compute_torques(x, u, links, a);
    coulomb.set_friction(x, x, u, list_drive_modes());
    auto M = compute_loaded_inertia(links);
    coulomb.solve_in(friction, M.at, a);
  }

  // body(drive, j, its inputs, its held parts, D dz/dt, the link's acceleration) of each joint at
  // x.
  template <class Body>
  void for_each_drive_rate(const State<S>& x, const Real* u, Body&& body) const {
    Dynamics links;
    Links<S>::compute_dynamics_apart(*n_, x.q, x.v, links);
    Real a[N];
    Friction coulomb(*n_);
    compute_accelerations(x, u, links, a, coulomb);
    n_->for_each_drive([&](const auto& drive, int j) {
      const auto now = drive_modes(drive, j);
      const auto at = drive.apply_modes(input_of(drive, j, x, u[j]), now);
      body(drive, j, at, now.active(), drive.rates(at, now.active()).f, a[j]);
    });
  }

  // Conditions under which the modes hold: a joint goes on in its direction, its drive and its lock
  // hold.
  static constexpr int conditions = 3 * N;
  // Distance of x from the next change of mode, negative if a mode no longer holds. (The least of
  // quantities with different units; only its sign counts.) `each` gets that of each condition; 1
  // where there is no such condition, or the lock of a joint while others already fail.
  Real margin(const State<S>& x, const Real* u, LinksMemo<S>& memo, Real* each = nullptr) const {
    Real smallest = 1.0;
    for (int k = 0; each && k < conditions; ++k) each[k] = 1.0;
    const auto lower_to = [&](int k, Real margin) {
      smallest = margin < smallest ? margin : smallest;
      if (each) each[k] = margin;
    };
    n_->for_each_drive([&]<class Drive>(const Drive& drive, int j) {
      if (Friction::present && friction.direction[j] != 0.0)
        lower_to(j, x.v[j] * friction.direction[j]);
      if constexpr (Drive::modes > 0)
        lower_to(N + j, drive.margin(input_of(drive, j, x, u[j]), drive_modes(drive, j)));
    });
    if (smallest < 0.0 || !Friction::present || !friction.has_locked()) return smallest;
    Friction coulomb(*n_);
    find_lock_torques(x, u, memo.find_at(*n_, x), coulomb);
    for (int j = 0; j < N; ++j)
      if (friction.locked[j]) lower_to(2 * N + j, coulomb.lock_margin(j));
    return smallest;
  }

  // Find the torques of the locks at x.
  void find_lock_torques(const State<S>& x, const Real* u, const Dynamics& links,
                         Friction& coulomb) const {
    Real a[N];
    compute_torques(x, u, links, a);
    coulomb.set_friction(x, x, u, list_drive_modes());
    coulomb.find_lock_torques(friction, [&] { return compute_loaded_inertia(links); }, a);
  }

  // Set x to the values that its modes hold: stopped joints rest, a current is within its limit, a
  // current without inductance follows the voltage.
  void enforce_modes(State<S>& x, const Real* u) const {
    n_->for_each_drive([&]<class Drive>(const Drive& drive, int j) {
      if (friction.locked[j] || x.v[j] * friction.direction[j] < 0.0) x.v[j] = 0.0;
      if constexpr (Drive::modes > 0) {
        auto at = input_of(drive, j, x, u[j]);
        drive.enforce_modes(at, drive_modes(drive, j));
        store_states(drive, j, 0, at, x);
      }
    });
    set_algebraic_states(*n_, x, u);
  }

 private:
  const Numbers<S>* n_;

  auto list_drive_modes() const {
    return [&](const auto& drive, int j, int) { return drive_modes(drive, j); };
  }

  // M with the rotors that the links carry.
  auto compute_loaded_inertia(const Dynamics& links) const {
    auto M = links.M;
    n_->for_each_drive([&](const auto& drive, int j) { M.at[j][j] += drive.carried(); });
    return M;
  }
  // Torques that accelerate the links, without dry friction.
  void compute_torques(const State<S>& x, const Real* u, const Dynamics& links, Real* rhs) const {
    n_->for_each_drive([&](const auto& drive, int j) __attribute__((always_inline)) {
      const auto modes = drive_modes(drive, j);
      const auto at = drive.apply_modes(input_of(drive, j, x, u[j]), modes);
      rhs[j] = drive.rates(at, modes.active()).g - links.nle[j];
    });
  }
};

// Whether steps are cut where a mode changes.
template <class S>
inline constexpr bool kLocatesEvents = S::events == Events::located && Modes<S>::present;

}  // namespace arm
