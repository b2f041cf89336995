// The derivatives of a motion with located events: the parts of its steps
// (step_segments.hpp), taken again with numbers that carry derivatives.
//
// The modes of each part and its length were decided for the values, which are
// put in here. The instant of an event has derivatives by the implicit function
// theorem.
#pragma once

#include <optional>

#include "mechanics/command_bounds.hpp"
#include "mechanics/modes.hpp"
#include "schemes/step_segments.hpp"
#include "schemes/step_slopes.hpp"

namespace arm {

template <class S>
class DerivativeReplay {
 public:
  using Method = MethodOf<S, Real>;
  using Part = typename Method::Part;
  using Dynamics = typename Links<S>::Dynamics;
  static constexpr int N = S::N, K = State<S>::K, row = Method::row;
  using Piece = arm::Piece<N, K>;
  using SlopesOfStep = StepSlopes<S, Method, S::Scheme::extrapolates>;
  using SlopesOfPart = StepSlopes<S, Part, false>;

  DerivativeReplay(Real step, const Real* parameters, const State<S>& start)
      : h_(step), n_(parameters), full_(step, n_), part_(step, n_), x_(start) {
    static const ChangedDrives<S> changed;
    full_.reset(x_);
    own_.links = LinkSlopes<S>::has_own_slopes(n_, x_);
    n_.for_each_drive([&]<class Drive>(const Drive& drive, int) {
      ever_regular_ = ever_regular_ && (Drive::modes == 0 || drive.is_ever_regular());
    });
    for (int k = 0; k < S::parameters; ++k)
      for (int j = 0; j < N; ++j)
        own_drive_[j] = own_drive_[j] || (has_derivatives(parameters[k]) && changed.at[k][j]);
  }
  DerivativeReplay(const DerivativeReplay&) = delete;
  DerivativeReplay& operator=(const DerivativeReplay&) = delete;

  const Numbers<S>& numbers() const { return n_; }
  const State<S>& state() const { return x_; }

  // Begin a row of commands.
  void begin_row(const double* commands) {
    for (int j = 0; j < N; ++j) u_[j] = commands[j];
    bound_commands(n_, x_, u_);
    for (int j = 0; j < N; ++j) own_.at[j] = own_drive_[j] || has_derivatives(u_[j]);
  }
  // The machine without derivatives, shared by its followers.
  struct Values {
    const Numbers<S> n;
    Method method;
    Part part;
    bool is_single;  // the only one that follows

    Values(Real step, const Real* parameters, bool alone)
        : n(parameters), method(step, n), part(step, n), is_single(alone) {}
  };
  // Shared, too: of one of its parts what has been found.
  struct Common {
    bool begun = false, stepped = false, moved = false;
    State<S> start;
    LinkSlopes<S> links;
    std::optional<Modes<S>> regular;  // where its modes depend on nothing
    SlopesOfStep of_step;
    SlopesOfPart of_part;
    // The change of its end, and of the condition of an event, with its length.
    State<S> along;
    double slope;
  };

  // Take a part; `next` begins at its end.
  void replay_part(const Piece& piece, const Piece& next, Values& values, Common& common) {
    if (piece.end == PieceEnd::cut) {
      Dynamics links;
      Links<S>::compute_dynamics_apart(n_, x_.q, x_.v, links);
      full_.set_past(start_, x_, u_, links, Modes<S>(n_, x_, u_, links));
      cut_ = false;
      return;
    }
    set_algebraic_states(n_, x_, u_);
    if (!common.begun) begin_part(piece, next, values, common);
    std::optional<Modes<S>> modes;
    if (!common.regular || !piece.complete) {
      copy_values(piece, x_);
      modes = find_modes(n_, x_, u_, piece, next);
    }
    if (piece.complete) {
      move_state(piece, next, values, values.method, full_, h_, modes, common.of_step, common);
    } else {
      if (!cut_) start_ = x_, left_ = h_, cut_ = true;
      if (piece.end == PieceEnd::unlocated) return finish_step();
      const Real length = piece.end == PieceEnd::step ? left_ : piece.length;
      if (!common.moved) find_change_along(piece, next, values, common);
      move_state(piece, next, values, values.part, part_, length, modes, common.of_part, common);
      if (piece.end == PieceEnd::event)
        end_at_event(piece, *modes, common);
      else
        add_change_along(length, common);
    }
    copy_values(next, x_);
    if (modes) modes->enforce_modes(x_, u_);
  }

  // End a row of commands at the state at which `next` begins.
  void finish_row(const Piece& next) {
    set_algebraic_states(n_, x_, u_);
    copy_values(next, x_);
  }

 private:
  // Whether no joint is held by anything, so that no mode sets a state.
  static bool is_regular(const Piece& piece) {
    bool regular = true;
    for (int j = 0; j < N; ++j) regular = regular && !piece.locked[j] && !piece.active[j];
    return regular;
  }
  // Put the values of a state in the place of those here.
  static void copy_values(const Piece& of, State<S>& x) {
    for (int j = 0; j < N; ++j) {
      for (int k = 0; k < K; ++k) x.z[k][j].value = of.z[k][j];
      x.q[j].value = of.q[j], x.v[j].value = of.v[j];
    }
  }
  void set_commands(Real (&u)[row]) const {
    for (int j = 0; j < N; ++j) u[j] = constant(u_[j]);
  }
  void begin_part(const Piece& piece, const Piece& next, Values& values, Common& common) const {
    copy_values(piece, common.start);
    common.links.update(values.n, common.start);
    common.regular.reset();
    if (ever_regular_ && is_regular(piece))
      common.regular = find_modes(values.n, common.start, u_, piece, next);
    common.begun = true, common.stepped = common.moved = false;
  }

  // Take the step or the part with what all have in common.
  template <class Taking, class Slopes>
  void move_state(const Piece& piece, const Piece& next, const Values& values, Taking& of_values,
                  Taking& own, const Real& length, const std::optional<Modes<S>>& modes,
                  Slopes& slopes, Common& common) {
    const Numbers<S>& n = values.n;
    const double h = length.value;
    if (values.is_single)
      return slopes.move_single(own, n_, n, common.links, modes ? *modes : *common.regular,
                                common.start, x_, u_, own.past(), own_, h);
    if (!common.stepped) {
      alignas(64) Real u[row] = {};
      set_commands(u);
      slopes.update(of_values, n, common.links, common.start, u, own.memory(), h,
                    [&](const State<S>& x) { return find_modes(n, x, u, piece, next); });
      common.stepped = true;
    }
    if (own_.any()) {
      const auto update_own = [&](const Modes<S>& modes) {
        slopes.update_own(own, n_, modes, common.start, u_, h, own_);
      };
      common.regular ? update_own(*common.regular)
                     : update_own(find_modes(n_, common.start, u_, piece, next));
    }
    slopes.move_state(x_, own.past(), own_, h);
  }

  // The modes in which it was taken. Where rounding lets the state at its start
  // call for others, that at its end knows them.
  static Modes<S> find_modes(const Numbers<S>& n, const State<S>& x, const Real* u,
                             const Piece& piece, const Piece& next) {
    typename Modes<S>::Friction::Modes friction;
    for (int j = 0; j < N; ++j)
      friction.locked[j] = piece.locked[j], friction.direction[j] = piece.direction[j];
    Modes<S> modes(n, friction);
    n.for_each_drive([&]<class Drive>(const Drive& drive, int j) {
      if constexpr (Drive::modes > 0) {
        if (!piece.active[j] && drive.is_ever_regular()) return;
        auto at = input_of(drive, j, x, u[j]);
        auto now = drive.modes_at(at);
        if (now.active() != piece.active[j]) {
          for (int k = 0; k < Drive::states; ++k) at.z[k].value = next.z[k][j];
          at.q.value = next.q[j], at.v.value = next.v[j];
          now = drive.modes_at(at);
          for (int m = 0; m < Drive::modes; ++m) now.at[m].active = is_active(piece.active[j], m);
        }
        modes.drive[j] = resize_modes<Modes<S>::M>(now);
      }
    });
    return modes;
  }

  // At its length, and along it: dt = -dg / (dg/dt) of the condition's g.
  void end_at_event(const Piece& piece, const Modes<S>& modes, const Common& common) {
    Real length = piece.length;
    const Real g = evaluate_condition(piece, modes, x_, u_);
    length.by = common.slope != 0.0 ? -g.by / common.slope : 0.0 * g.by;
    add_change_along(length, common);
    left_ -= length;
  }
  void add_change_along(const Real& length, const Common& common) {
    for_each_pair(x_, common.along,
                  [&](Real& x, const Real& along) { x.by += along.by[0] * length.by; });
  }
  void find_change_along(const Piece& piece, const Piece& next, Values& values,
                         Common& common) const {
    alignas(64) Real u[row] = {};
    set_commands(u);
    const Modes<S> modes = find_modes(values.n, common.start, u, piece, next);
    Dynamics links;
    Links<S>::compute_dynamics_apart(values.n, common.start.q, common.start.v, links);
    Real length = piece.end == PieceEnd::step ? constant(left_) : piece.length;
    length.by[0] = 1.0;
    common.along = common.start;
    values.part.set_step(length, modes);
    values.part.step_in_modes(modes, common.along, u, links);
    if (piece.end == PieceEnd::event)
      common.slope = evaluate_condition(piece, modes, common.along, u).by[0];
    common.moved = true;
  }
  static Real evaluate_condition(const Piece& piece, const Modes<S>& modes, const State<S>& x,
                                 const Real* u) {
    LinksMemo<S> memo;
    Real each[Modes<S>::conditions];
    modes.margin(x, u, memo, each);
    return each[piece.failing];
  }
  static void for_each_pair(State<S>& x, const State<S>& y, auto&& pair) {
    for (int j = 0; j < N; ++j) {
      for (int k = 0; k < K; ++k) pair(x.z[k][j], y.z[k][j]);
      pair(x.q[j], y.q[j]), pair(x.v[j], y.v[j]);
    }
  }
  void finish_step() {
    NullExchange no_exchange;
    Dynamics links;
    Links<S>::compute_dynamics_apart(n_, x_.q, x_.v, links);
    Method part(left_, n_);
    part.reset(x_);
    part.step(x_, u_, links, no_exchange);
    set_algebraic_states(n_, x_, u_);
  }

  Real h_, left_ = 0.0;
  const Numbers<S> n_;
  Method full_;
  Part part_;
  State<S> x_, start_;
  alignas(64) Real u_[row] = {};
  bool cut_ = false;
  bool own_drive_[N] = {};    // has derivatives
  bool ever_regular_ = true;  // all drives are, in some states
  OwnSlopes<S> own_;
};

}  // namespace arm
