// What each joint does at an instant: it slides or is locked (coulomb.hpp), its current is within
// its limit or at it (dc_motor.hpp). That follows from the state and the commands: nothing has to
// be remembered.
#pragma once

#include "coulomb.hpp"
#include "links.hpp"
#include "state.hpp"

namespace arm {

template <class S>
class Modes {
 public:
  static constexpr int N = S::N;
  using Dynamics = typename Links<S>::Dynamics;
  using Friction = Coulomb<S, double>;

  // Whether this scene has any modes but one.
  static constexpr bool present =
      Friction::present || any_drive<S>([](const auto& drive) { return drive.motor.has_limit(); });

  typename Friction::Modes friction;
  double side[N] = {};  // of the limit at which the current is: 1 or -1, or 0 within

  // Those of the settled state x (see below) with its links' part.
  Modes(const Numbers<S>& numbers, const State<S>& x, const double* u, const Dynamics& links)
      : n(&numbers) {
    n->for_each_drive([&](const auto& drive, int j) {
      if constexpr (drive.driven) {
        if (!drive.motor.has_limit()) return;
        const auto at = input_of(drive, j, x, u[j]);
        side[j] = drive.motor.side_of(at.z[drive.i]);
        if (side[j] * drive.motor.surplus(at.z[drive.i], at.u, drive.motor_speed(at)) < 0.0)
          side[j] = 0.0;
      }
    });
    if constexpr (Friction::present) {
      Friction coulomb(*n);
      Dynamics at = links;
      double a[N];
      torques(x, u, at, a);
      coulomb.solve(at.M.at, x.v, a);
      friction = coulomb.modes();
    }
  }

  // The links' accelerations at x.
  void accelerations(const State<S>& x, const double* u, Dynamics links, double (&a)[N],
                     Friction& coulomb) const {
    torques(x, u, links, a);
    coulomb.solve_in(friction, links.M.at, a);
  }

  // How far x is from where a mode changes: negative if one does not hold any more. Beyond zero by
  // rounding is not beyond. (Of quantities that differ in unit the least; only its sign counts.)
  double margin(const State<S>& x, const double* u) const {
    double least = 1.0;
    const auto at_most = [&least](double margin) { least = margin < least ? margin : least; };
    n->for_each_drive([&](const auto& drive, int j) {
      if (n->Dc(j) > 0.0 && !friction.locked[j]) at_most(x.v[j] * friction.direction[j]);
      if constexpr (drive.driven) {
        if (!drive.motor.has_limit()) return;
        const auto& motor = drive.motor;
        const auto at = input_of(drive, j, x, u[j]);
        const double wm = drive.motor_speed(at), limit = motor.current_limit;
        if (side[j] == 0.0) {
          const double i = motor.L > 0.0 ? at.z[drive.i] : motor.current_at_once(at.u, wm);
          at_most(limit * (1.0 + kRounding) - magnitude(i));
        } else {
          const double rounding = kRounding * (magnitude(at.u) + motor.R * limit);
          at_most(side[j] * motor.surplus(side[j] * limit, at.u, wm) + rounding);
        }
      }
    });
    if (least < 0.0 || !any_locked()) return least;
    Dynamics links;
    Links<S>::dynamics_apart(*n, x.q, x.v, links);
    double a[N];
    Friction coulomb(*n);
    accelerations(x, u, links, a, coulomb);
    for (int j = 0; j < N; ++j)
      if (friction.locked[j]) at_most(coulomb.spare(j) + kRounding * n->Ds(j));
    return least;
  }

  // Put x where its modes say: joints that have come to rest are at rest, a current is not beyond
  // its limit, and without inductance it is what the voltage makes it.
  void settle(State<S>& x, const double* u) const {
    if constexpr (Friction::present)
      for (int j = 0; j < N; ++j)
        if (n->Dc(j) > 0.0 && x.v[j] * friction.direction[j] <= 0.0) x.v[j] = 0.0;
    settle_currents(*n, x, u);
  }
  static void settle_currents(const Numbers<S>& n, State<S>& x, const double* u) {
    n.for_each_drive([&](const auto& drive, int j) {
      if constexpr (drive.driven) {
        const auto at = input_of(drive, j, x, u[j]);
        double& i = x.z[drive.i][j];
        if (drive.motor.L == 0.0) i = drive.motor.current_at_once(at.u, drive.motor_speed(at));
        if (drive.motor.has_limit()) i = clamp(i, drive.motor.current_limit);
      }
    });
  }

 private:
  static constexpr double kRounding = 1e-12;
  const Numbers<S>* n;

  bool any_locked() const {
    bool found = false;
    if constexpr (Friction::present)
      for (int j = 0; j < N; ++j) found = found || friction.locked[j];
    return found;
  }

  // What is left for the links to accelerate with, beside dry friction; M with the rotors that they
  // carry.
  void torques(const State<S>& x, const double* u, Dynamics& links, double* rhs) const {
    n->for_each_drive([&](const auto& drive, int j) {
      links.M.at[j][j] += drive.carried();
      rhs[j] = drive.rates(input_of(drive, j, x, u[j]), false).g - links.nle[j];
    });
  }
};

}  // namespace arm
