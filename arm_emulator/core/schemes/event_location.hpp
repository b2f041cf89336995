// A scheme of second order whose steps are cut where a mode of a joint changes: where it comes to
// rest or breaks away, where its current reaches its limit or leaves it. Between two such events
// the motion is smooth, and the scheme keeps its order.
//
// A step is first taken whole, with the modes that its start calls for (modes.hpp). If they hold at
// its end, the step is done. If not, a search finds the length at whose end the first of them
// ceases to hold: each trial is a step with tables for its length. The rest of the step continues
// with the modes of that state, so the grid of steps is unchanged. A mode that ceases to hold and
// holds again within one step is missed, at a cost of O(h^3).
//
// After kMaxEvents events in one step, its rest is taken without location: the step does not
// resolve events that dense (a motor far faster than the step).
#pragma once

#include "mechanics/energy_flow.hpp"
#include "schemes/scheme.hpp"
#include "schemes/step_segments.hpp"
#include "schemes/stored_modes.hpp"

namespace arm {

template <class S>
class EventLocation {
 public:
  using Method = MethodOf<S, Real>;
  using Part = typename Method::Part;
  using Dynamics = typename Links<S>::Dynamics;
  using Memory = typename Method::Memory;
  static constexpr int N = S::N, row = Method::row;

  EventLocation(Real step, const Numbers<S>& numbers)
      : h_(step), n_(numbers), full_(step, numbers), part_(step, numbers), stored_(numbers) {}
  void update_tables() {
    invalidate();
    full_.update_tables();
    part_.update_tables();
  }
  void reset(const State<S>& x) {
    invalidate();
    full_.reset(x);
  }
  Memory memory() const { return full_.memory(); }
  void restore(const Memory& memory) {
    invalidate();
    full_.restore(memory);
  }
  // The state or what acts on it has changed since the last step.
  void invalidate() {
    memo_.invalidate();
    stored_.invalidate();
  }

  // The links' part at x.
  const Dynamics& find_links_at(const State<S>& x) { return memo_.find_at(n_, x); }

  // Where the parts of steps are noted, or null.
  using StepSegments = arm::StepSegments<N, State<S>::K>;
  void record_segments_in(StepSegments* pieces)
    requires(kRecords)
  {
    record_.in = pieces;
  }

  // Meter for the smooth parts of steps, or null.
  void set_meter(EnergyMeter<S>* by) { meter_ = by; }

  template <class Exchange>
  void step(State<S>& x, const Real (&u)[row], const Dynamics&, Exchange&) {
    set_algebraic_states(n_, x, u);
    if (!stored_.begin_step(x, u, memo_)) full_.set_modes(stored_.modes());
    const Modes<S>& modes = stored_.modes();
    const Memory memory = full_.memory();
    State<S> y = x;
    if (stored_.are_links_at_rest())
      full_.step_at_rest(y, u, memo_.find_at(n_, x));
    else
      full_.step_consuming_links(memo_.release_links(), modes.friction, y, u);
    if (stored_.end_step(y, u, memo_)) {
      meter_part(x, y, u, modes, h_);
      record_part(PieceEnd::step, x, modes, h_, true);
      x = y;
    } else {
      full_.restore(memory);
      Trial full;  // while the links' part at y is known
      full.evaluate(h_, modes, y, u, memo_);
      step_to_events(x, y, u, modes, full);
    }
  }
  // A step that is known as a whole: from x to y, with all drives in their regular modes
  // and the links in these. The memory is that of y.
  void step_to(const State<S>& y, const typename Modes<S>::Friction::Modes& friction, State<S>& x,
               const Real (&u)[row]) {
    const Modes<S> modes(n_, friction);
    State<S> end = y;
    Trial full;
    full.evaluate(h_, modes, end, u, memo_);
    if (!full.is_valid()) return step_to_events(x, end, u, modes, full);
    modes.enforce_modes(end, u);
    x = end;
  }

 private:
  static constexpr int kMaxEvents = 4 * N + 8;
  static constexpr int kMaxTrials = 150;
  // Share of a step within which an event's time is known. Conditions are rounded so that a better
  // one takes trials without progress.
  static constexpr double kInstant = 1e-10;

  // An end of a step, and how far it is from each condition of the modes.
  struct Trial {
    Real t, margin, each[Modes<S>::conditions];

    void evaluate(Real length, const Modes<S>& modes, const State<S>& end, const Real (&u)[row],
                  LinksMemo<S>& memo) {
      t = length;
      margin = modes.margin(end, u, memo, each);
    }
    bool is_valid() const { return !(margin < 0.0); }
    // A condition that fails.
    int find_failing() const {
      int k = 0;
      while (!(each[k] < 0.0)) ++k;
      return k;
    }
    // The share of the way to `end` at which a condition is zero on a straight line.
    Real find_zero(const Trial& end, int condition) const {
      return each[condition] / (each[condition] - end.each[condition]);
    }
    // The condition that fails first between a trial that holds and this one, on straight lines; -1
    // if that cannot be known.
    ARM_APART int find_first_failure(const Trial& sound) const {
      int first = -1;
      for (int k = 0; k < Modes<S>::conditions; ++k)
        if (each[k] < 0.0 && sound.each[k] > 0.0 &&
            (first < 0 || sound.find_zero(*this, k) < sound.find_zero(*this, first)))
          first = k;
      return first;
    }
  };

  // A step from x to y of which not all modes hold.
  void step_to_events(State<S>& x, State<S> y, const Real (&u)[row], Modes<S> modes, Trial full) {
    const State<S> start = x;
    Dynamics links = memo_.find_at(n_, x);
    Real left = h_;
    for (int events = 0; left > kInstant * h_; ++events) {
      if (events == kMaxEvents) {
        finish_unlocated(left, x, u, links, modes);
        break;
      }
      if (events > 0) {
        y = x;
        part_.set_step(left, modes);
        part_.step_in_modes(modes.friction, y, u, links);
        full.evaluate(left, modes, y, u, memo_);
      }
      const bool fails = !full.is_valid();
      const Real t = fails ? find_first_event(x, y, u, modes, links, full) : left;
      modes.enforce_modes(y, u);
      meter_part(x, y, u, modes, t);
      record_part(fails ? PieceEnd::event : PieceEnd::step, x, modes, t);
      x = y;
      left -= t;
      links = memo_.find_at(n_, x);
      modes = Modes<S>(n_, x, u, links);
    }
    full_.set_past(start, x, u, links, modes);
    full_.set_modes(modes);
    stored_.set(modes);
    record_part(PieceEnd::cut, x, modes, 0.0);
  }

  // The rest of a step with too many events.
  ARM_ONCE void finish_unlocated(Real length, State<S>& x, const Real (&u)[row], Dynamics& links,
                                 Modes<S>& modes) {
    Method part(length, n_);
    State<S> y = x;
    NullExchange no_exchange;
    part.reset(y);
    part.step(y, u, links, no_exchange);
    set_algebraic_states(n_, y, u);
    meter_part(x, y, u, modes, length);
    record_part(PieceEnd::unlocated, x, modes, length);
    x = y;
    links = memo_.find_at(n_, x);
    modes = Modes<S>(n_, x, u, links);
  }

  void meter_part(const State<S>& x, const State<S>& y, const Real (&u)[row], const Modes<S>& modes,
                  Real length) {
    if constexpr (S::energy_flow)
      if (meter_) meter_->add_part(x, y, u, modes, length);
  }

  void record_part([[maybe_unused]] PieceEnd end, [[maybe_unused]] const State<S>& x,
                   [[maybe_unused]] const Modes<S>& modes, [[maybe_unused]] Real length,
                   [[maybe_unused]] bool complete = false) {
    if constexpr (kRecords) {
      if (!record_.in) return;
      auto& piece = record_.in->emplace_back();
      piece.end = end, piece.failing = record_.failing, piece.length = length,
      piece.complete = complete;
      for (int j = 0; j < N; ++j) {
        piece.locked[j] = modes.friction.locked[j];
        piece.direction[j] = modes.friction.direction[j];
        piece.active[j] = modes.drive[j].active();
        for (int k = 0; k < State<S>::K; ++k) piece.z[k][j] = x.z[k][j];
        piece.q[j] = x.q[j], piece.v[j] = x.v[j];
      }
    }
  }

  // Return the time at which the first mode ceases to hold, somewhat below `left`. It is found by
  // inverse quadratic interpolation or, where that is not safe, by halves (Chandrupatla, Adv. Eng.
  // Software 28, 1997). y is the state then, in which the mode no longer holds.
  Real find_first_event(const State<S>& x, State<S>& y, const Real (&u)[row], const Modes<S>& modes,
                        const Dynamics& links, Trial bracket) {
    Trial last;
    last.evaluate(0.0, modes, x, u, memo_);
    int first = bracket.find_first_failure(last);
    Real share = first < 0 ? 0.5 : last.find_zero(bracket, first);
    for (int trial = 0; trial < kMaxTrials; ++trial) {
      const Real width = bracket.t - last.t;  // of either sign
      const Real smallest_share = 0.5 * kInstant * h_ / magnitude(width);
      if (smallest_share >= 0.5) break;
      // A little beyond the zero, so that the trial that meets it is one that fails.
      if (first >= 0) share += last.is_valid() ? 0.5 * smallest_share : -0.5 * smallest_share;
      share = share < smallest_share         ? smallest_share
              : share > 1.0 - smallest_share ? 1.0 - smallest_share
                                             : share;
      const Real t = last.t + share * width;
      State<S> end = x;
      part_.set_step(t, modes);
      part_.step_in_modes(modes.friction, end, u, links);
      Trial now;
      now.evaluate(t, modes, end, u, memo_);
      if (!now.is_valid()) y = end;
      Trial before = last;
      if (now.is_valid() != last.is_valid()) before = bracket, bracket = last;
      last = now;
      first = last.is_valid() ? bracket.find_first_failure(last) : last.find_first_failure(bracket);
      // The zero lies within an instant before a trial that fails.
      if (first >= 0 && !last.is_valid() &&
          magnitude(last.find_zero(bracket, first) * (bracket.t - last.t)) <= kInstant * h_)
        break;
      share = first < 0 ? 0.5 : choose_share(last, bracket, before, first);
    }
    const Real t = last.is_valid() ? bracket.t : last.t;
    if constexpr (kRecords) record_.failing = (last.is_valid() ? bracket : last).find_failing();
    return t;
  }
  // Next trial for the zero of a condition between `last` and `bracket`, of which one holds.
  static Real choose_share(const Trial& last, const Trial& bracket, const Trial& before, int k) {
    const Real at = last.each[k], there = bracket.each[k], past = before.each[k];
    const Real xi = (last.t - bracket.t) / (before.t - bracket.t);
    const Real phi = (at - there) / (past - there);
    if (!(phi * phi < xi && (1.0 - phi) * (1.0 - phi) < 1.0 - xi)) return 0.5;
    return at / (there - at) * past / (there - past) +
           (before.t - last.t) / (bracket.t - last.t) * at / (past - at) * there / (past - there);
  }

  Real h_;
  const Numbers<S>& n_;
  Method full_;
  Part part_;  // of a step
  LinksMemo<S> memo_;
  StoredModes<S> stored_;
  EnergyMeter<S>* meter_ = nullptr;
  struct Record {
    StepSegments* in = nullptr;
    int failing = -1;
  };
  [[no_unique_address]] std::conditional_t<kRecords, Record, Nothing> record_;
};

}  // namespace arm
