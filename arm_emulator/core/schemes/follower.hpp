// The derivatives of a motion with located events: the parts of its steps (pieces.hpp), taken again
// with numbers that carry derivatives.
//
// The modes of each part and its length were decided for the values, which are put in here.
// The instant of an event has derivatives by the implicit function theorem.
#pragma once

#include "mechanics/command_bounds.hpp"
#include "mechanics/link_slopes.hpp"
#include "mechanics/modes.hpp"
#include "schemes/pieces.hpp"
#include "schemes/scheme.hpp"

namespace arm {

template <class S>
class Follower {
 public:
  using Method = MethodOf<S, Real>;
  using Part = typename Method::Part;
  using Dynamics = typename Links<S>::Dynamics;
  static constexpr int N = S::N, K = State<S>::K, row = Method::row;
  using Piece = arm::Piece<N, K>;

  Follower(Real step, const Real* parameters, const State<S>& start)
      : h_(step), n_(parameters), whole_(step, n_), part_(step, n_), x_(start) {
    whole_.reset(x_);
    own_links_ = LinkSlopes<S>::own(n_, x_);
  }
  Follower(const Follower&) = delete;
  Follower& operator=(const Follower&) = delete;

  const Numbers<S>& numbers() const { return n_; }
  const State<S>& state() const { return x_; }

  // Begin a row of commands.
  void command(const double* commands) {
    for (int j = 0; j < N; ++j) u_[j] = commands[j];
    bound_commands(n_, x_, u_);
  }
  // Shared by all followers of a machine, of one of its parts.
  struct Common {
    bool known = false;
    LinkSlopes<S> links;
  };

  // Take a part; `next` begins at its end.
  void follow(const Piece& piece, const Piece& next, const Numbers<S>& values, Common& common) {
    Dynamics links;
    if (piece.end == PieceEnd::cut) {
      Links<S>::dynamics_apart(n_, x_.q, x_.v, links);
      whole_.remember(start_, x_, u_, links);
      cut_ = false;
      return;
    }
    follow_at_once(n_, x_, u_);
    put_values(piece);
    const Modes<S> modes = modes_of(piece, next);
    if (own_links_) {
      Links<S>::dynamics_apart(n_, x_.q, x_.v, links);
    } else {
      if (!common.known) common.links.take(values, x_);
      common.known = true;
      common.links.put(x_, links);
    }
    if (!piece.whole && !cut_) start_ = x_, left_ = h_, cut_ = true;
    if (piece.whole)
      whole_.step_in(modes, x_, u_, links, Method::Past::used);
    else if (piece.end == PieceEnd::unlocated)
      finish(links);
    else
      take_part(piece, modes, links);
    if (piece.end == PieceEnd::unlocated)
      follow_at_once(n_, x_, u_);
    else if (!piece.whole || !is_usual(piece))
      modes.settle(x_, u_);
  }

  // End a row of commands at the state at which `next` begins.
  void end_row(const Piece& next) {
    follow_at_once(n_, x_, u_);
    put_values(next);
  }

  // Put the values of a state in the place of those here.
  void put_values(const auto& of) {
    for (int j = 0; j < N; ++j) {
      for (int k = 0; k < K; ++k) x_.z[k][j].value = of.z[k][j];
      x_.q[j].value = of.q[j], x_.v[j].value = of.v[j];
    }
  }

 private:
  using Past = typename Part::Past;

  // Whether no joint is held by anything, so that nothing settles.
  static bool is_usual(const Piece& piece) {
    bool usual = true;
    for (int j = 0; j < N; ++j) usual = usual && !piece.locked[j] && !piece.held[j];
    return usual;
  }
  // The modes in which it was taken. Where rounding lets the state at its start call for others,
  // that at its end knows them.
  Modes<S> modes_of(const Piece& piece, const Piece& next) const {
    typename Modes<S>::Friction::Modes friction;
    for (int j = 0; j < N; ++j)
      friction.locked[j] = piece.locked[j], friction.direction[j] = piece.direction[j];
    Modes<S> modes(n_, friction);
    n_.for_each_drive([&]<class Drive>(const Drive& drive, int j) {
      if constexpr (Drive::modes > 0) {
        if (!piece.held[j] && drive.is_ever_usual()) return;
        auto at = input_of(drive, j, x_, u_[j]);
        auto now = drive.modes_at(at);
        if (now.held() != piece.held[j]) {
          for (int k = 0; k < Drive::states; ++k) at.z[k].value = next.z[k][j];
          at.q.value = next.q[j], at.v.value = next.v[j];
          now = drive.modes_at(at);
          for (int m = 0; m < Drive::modes; ++m) now.at[m].held = is_held(piece.held[j], m);
        }
        modes.drive[j] = resized<Modes<S>::M>(now);
      }
    });
    return modes;
  }

  void take_part(const Piece& piece, const Modes<S>& modes, const Dynamics& links) {
    const State<S> start = x_;
    const auto take = [&](const Real& length) {
      x_ = start;
      part_.retime(length, modes);
      part_.step_in(modes, x_, u_, links, Past::unknown);
    };
    if (piece.end == PieceEnd::step) return take(left_);
    // At this length, and along it: dt = -dg / (dg/dt) of the condition's g.
    Real length = piece.length;
    take(length);
    const State<S> y = x_;
    const Real g = condition(piece, modes);
    length.by[0] = 1.0;
    take(length);
    const double slope = condition(piece, modes).by[0] - g.by[0];
    length.by = slope != 0.0 ? -g.by / slope : 0.0 * g.by;
    for_each_pair(x_, y, [&](Real& along, const Real& at) {
      along = {at.value, at.by + (along.by[0] - at.by[0]) * length.by};
    });
    left_ -= length;
  }
  Real condition(const Piece& piece, const Modes<S>& modes) const {
    LinksMemo<S> memo;
    Real each[Modes<S>::conditions];
    modes.margin(x_, u_, memo, each);
    return each[piece.failing];
  }
  static void for_each_pair(State<S>& x, const State<S>& y, auto&& pair) {
    for (int j = 0; j < N; ++j) {
      for (int k = 0; k < K; ++k) pair(x.z[k][j], y.z[k][j]);
      pair(x.q[j], y.q[j]), pair(x.v[j], y.v[j]);
    }
  }
  void finish(const Dynamics& links) {
    Nobody nobody;
    Dynamics own = links;
    Method part(left_, n_);
    part.reset(x_);
    part.step(x_, u_, own, nobody);
  }

  Real h_, left_ = 0.0;
  const Numbers<S> n_;
  Method whole_;
  Part part_;
  State<S> x_, start_;
  alignas(64) Real u_[row] = {};
  bool cut_ = false;
  bool own_links_;  // have derivatives
};

}  // namespace arm
