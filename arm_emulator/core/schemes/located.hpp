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
// After kMostEvents events in one step, its rest is taken without location: the step does not
// resolve events that dense (a motor far faster than the step).
#pragma once

#include "mechanics/energy_flow.hpp"
#include "mechanics/modes.hpp"
#include "schemes/linearly_implicit.hpp"

namespace arm {

template <class S>
class Located {
 public:
  using Method = LinearlyImplicit<S>;
  using Dynamics = typename Links<S>::Dynamics;
  using Memory = typename Method::Memory;
  static constexpr int N = S::N, row = Method::row;

  Located(double step, const Numbers<S>& numbers) : h_(step), n_(numbers), whole_(step, numbers) {}
  void renew() {
    memo_.forget();
    whole_.renew();
  }
  void reset(const State<S>& x) {
    memo_.forget();
    whole_.reset(x);
  }
  Memory memory() const { return whole_.memory(); }
  void restore(const Memory& memory) {
    memo_.forget();
    whole_.restore(memory);
  }

  // The links' part at x.
  const Dynamics& links_at(const State<S>& x) { return memo_.at(n_, x); }

  // Meter for the smooth parts of steps, or null.
  void watch(EnergyMeter<S>* by) { meter_ = by; }

  template <class Exchange>
  void step(State<S>& x, const double (&u)[row], const Dynamics& given, Exchange& exchange) {
    Dynamics links = given;
    exchange.take(links);
    follow_at_once(n_, x, u);
    const Modes<S> modes(n_, x, u, links);
    const Memory memory = whole_.memory();
    State<S> y = x;
    whole_.step_in(modes, y, u, links, Past::used);
    if (modes.margin(y, u, memo_) < 0.0) {
      whole_.restore(memory);
      cut(x, y, u, modes, links);
    } else {
      modes.settle(y, u);
      if (meter_) meter_->part(x, y, u, modes, h_);
      x = y;
    }
    exchange.give(x);
  }

 private:
  using Past = typename Method::Past;
  static constexpr int kMostEvents = 4 * N + 8;
  static constexpr int kMostTrials = 150;
  static constexpr double kInstant = 1e-11;  // of a step: how well an event's time is known

  // A step from x to y of which not all modes hold.
  void cut(State<S>& x, State<S> y, const double (&u)[row], Modes<S> modes, Dynamics links) {
    const State<S> start = x;
    double left = h_;
    for (int events = 0; left > kInstant * h_; ++events) {
      Method part(left, n_, modes);
      if (events == kMostEvents) {
        y = x;
        Nobody nobody;
        part.reset(y);
        part.step(y, u, links, nobody);
        follow_at_once(n_, y, u);
        if (meter_) meter_->part(x, y, u, modes, left);
        x = y;
        break;
      }
      y = x;
      part.step_in(modes, y, u, links, Past::unknown);
      double t = left;
      if (modes.margin(y, u, memo_) < 0.0) t = first_event(x, y, u, modes, links, left, part);
      modes.settle(y, u);
      if (meter_) meter_->part(x, y, u, modes, t);
      x = y;
      left -= t;
      links = memo_.at(n_, x);
      modes = Modes<S>(n_, x, u, links);
    }
    whole_.remember(start, x, u);
  }

  // The time at which the first mode ceases to hold, somewhat below `left`, by inverse quadratic
  // interpolation or, where that is not safe, by halves (Chandrupatla, Adv. Eng. Software 28,
  // 1997); y is the state then, where it does not hold any more.
  double first_event(const State<S>& x, State<S>& y, const double (&u)[row], const Modes<S>& modes,
                     const Dynamics& links, double left, Method& part) {
    struct Trial {
      double t, margin;
      bool holds() const { return !(margin < 0.0); }
    };
    Trial last = {0.0, modes.margin(x, u, memo_)}, other = {left, modes.margin(y, u, memo_)};
    double share = last.margin > 0.0 ? last.margin / (last.margin - other.margin) : 0.5;
    for (int trial = 0; trial < kMostTrials; ++trial) {
      const double width = other.t - last.t;  // of either sign
      const double least = 0.5 * kInstant * h_ / magnitude(width);
      if (least >= 0.5) break;
      share = share < least ? least : share > 1.0 - least ? 1.0 - least : share;
      const double t = last.t + share * width;
      State<S> end = x;
      part.retime(t);
      part.step_in(modes, end, u, links, Past::unknown);
      const Trial now = {t, modes.margin(end, u, memo_)};
      if (!now.holds()) y = end;
      Trial before = last;
      if (now.holds() != last.holds()) before = other, other = last;
      last = now;
      share = next_share(last, other, before);
    }
    return last.holds() ? other.t : last.t;
  }
  // Next trial for the zero of the margin between `last` and `other`, of which one holds.
  static double next_share(const auto& last, const auto& other, const auto& before) {
    const double xi = (last.t - other.t) / (before.t - other.t);
    const double phi = (last.margin - other.margin) / (before.margin - other.margin);
    if (!(phi * phi < xi && (1.0 - phi) * (1.0 - phi) < 1.0 - xi)) return 0.5;
    return last.margin / (other.margin - last.margin) * before.margin /
               (other.margin - before.margin) +
           (before.t - last.t) / (other.t - last.t) * last.margin / (before.margin - last.margin) *
               other.margin / (before.margin - other.margin);
  }

  // Replaces the exchange with the thread of the links.
  struct Nobody {
    void take(Dynamics&) {}
    void give(const State<S>&) {}
  };

  double h_;
  const Numbers<S>& n_;
  Method whole_;
  LinksMemo<S> memo_;
  EnergyMeter<S>* meter_ = nullptr;
};

}  // namespace arm
