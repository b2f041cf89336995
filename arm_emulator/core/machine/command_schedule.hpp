// Commands for one machine, or several in lanes: rows, each held for some steps.
#pragma once

#include <cstdint>
#include <type_traits>

#include "mechanics/command_bounds.hpp"
#include "mechanics/energy.hpp"

namespace arm {

template <class S, class X, int row>
class CommandSchedule {
 public:
  static constexpr int N = S::N, width = kWidth<X>;

  // For each lane the first row of its commands, and where its positions after that row go, if not
  // null. `stride`: numbers from one row to the next, of both; `spacing`: from the command of a
  // joint to that of the next. If that is `width`, those of all lanes lie side by side.
  CommandSchedule(const Real* const (&commands)[width], Real* const (&positions)[width],
                  std::int64_t stride, std::int64_t steps_per_row, int spacing = 1,
                  std::int64_t steps_left = 0)
      : steps(steps_per_row), stride_(stride), spacing_(spacing), left_(steps_left) {
    for (int lane = 0; lane < width; ++lane)
      command_[lane] = commands[lane], q_[lane] = positions[lane];
  }

  // The remaining course of one lane.
  template <int single>
  CommandSchedule<S, Real, single> lane_schedule(int lane) const {
    return {{command_[lane]}, {q_[lane]}, stride_, steps, spacing_, left_};
  }

  // Begin the next row: `u` becomes its commands within their bounds. Returns where they differ
  // from those before.
  ARM_INLINE Mask<X> start_row(const Numbers<S, X>& numbers, const State<S, X>& x, X (&u)[row]) {
    Mask<X> differ = {};
    X bounded[N];
    if (width > 1 && spacing_ == width)
      __builtin_memcpy(bounded, command_[0], sizeof bounded);
    else
      for_each<N>([&](auto j) __attribute__((always_inline)) {
        for (int lane = 0; lane < width; ++lane)
          set_lane(bounded[j], lane, command_[lane][j * spacing_]);
      });
    bound_commands(numbers, x, bounded);
    for_each<N>([&](auto j) __attribute__((always_inline)) {
      differ |= bounded[j] != u[j];
      u[j] = bounded[j];
    });
    for (const Real*& next : command_) {
      next += stride_;
      if (width > 1) __builtin_prefetch(next + kAhead * stride_);
    }
    left_ = steps;
    return differ;
  }
  ARM_INLINE void finish_row(const State<S, X>& x) {
    for (int lane = 0; lane < width; ++lane) {
      if (!q_[lane]) continue;
      for_each<N>([&](auto j)
                      __attribute__((always_inline)) { q_[lane][j] = lane_of(x.q[j], lane); });
      q_[lane] += stride_;
      if (width > 1) __builtin_prefetch(q_[lane] + kAhead * stride_, 1);
    }
  }

  // Take `count` steps, or those before one that `threads` refuses; returns how many. `power` is
  // what the motors can be given at most under u, of which `most` is the sum.
  template <class Threads>
  ARM_INLINE int advance_steps(const Numbers<S, X>& numbers, Threads& threads, Real h, int count,
                               State<S, X>& y, X (&u)[row], X& power, X& most) {
    X energy = h * power;
    for (int s = 0; s < count; ++s) {
      if (left_ == 0) {
        const Mask<X> differ = start_row(numbers, y, u);
        if (any(differ)) {
          power = select(differ, EnergyBalance<S>::largest_power(numbers, y, u), power);
          energy = h * power;
        }
      }
      if constexpr (std::is_void_v<decltype(threads.step(y, u))>)
        threads.step(y, u);
      else if (!threads.step(y, u))
        return s;
      if constexpr (any_drive<S>([](const auto& drive) { return drive.supply_grows_with_speed; })) {
        const X now = EnergyBalance<S>::largest_power(numbers, y, u);
        energy = h * select(power < now, now, power);
        power = now;
      }
      most += energy;
      if (--left_ == 0) finish_row(y);
    }
    return count;
  }

  std::int64_t steps;  // of a row

 private:
  // Rows of many machines lie far apart: those to come are fetched so many ahead.
  static constexpr int kAhead = 8;
  const Real* command_[width];  // of the next row
  Real* q_[width];              // for the positions after this row
  std::int64_t stride_;
  int spacing_;
  std::int64_t left_;  // steps of this row
};

}  // namespace arm
