// Brakes close and open some steps after a request. A request that is withdrawn before has no
// effect.
#pragma once

#include <cstdint>

#include "mechanics/numbers.hpp"

namespace arm {

template <class S>
class Brakes {
 public:
  static constexpr int B = S::brakes;
  static constexpr std::int64_t never = INT64_MAX;

  Brakes() { set_all(false); }

  // Whether brake k is wanted closed.
  bool is_requested(int k) const { return requested_[k] != 0; }
  // Request brake k to close or open `delay` steps after step `now`.
  void request(int k, bool closed, bool is_closed, std::int64_t now, std::int64_t delay) {
    requested_[k] = closed;
    at_[k] = closed == is_closed ? never : now + delay;
  }
  // Set all of them as requested, without delay.
  void set_all(bool closed) {
    for (int k = 0; k < B; ++k) requested_[k] = closed, at_[k] = never;
  }

  // Step of the next change.
  std::int64_t next_change() const {
    std::int64_t first = never;
    for (int k = 0; k < B; ++k) first = at_[k] < first ? at_[k] : first;
    return first;
  }
  // change(k, closed) for those that are due at step `now`.
  template <class Change>
  void apply_due(std::int64_t now, Change&& change) {
    for (int k = 0; k < B; ++k) {
      if (at_[k] > now) continue;
      at_[k] = never;
      change(k, requested_[k] != 0);
    }
  }

  // number(x) for everything that is remembered, in a fixed order.
  template <class Number>
  void for_each_number(Number&& number) {
    for (int k = 0; k < B; ++k) number(requested_[k]), number(at_[k]);
  }

 private:
  std::int64_t requested_[B + 1] = {};
  std::int64_t at_[B + 1];
};

}  // namespace arm
