// Nested vectored interrupt controller: priorities of exceptions (ARMv7-M, B1.5).
#pragma once

#include <algorithm>
#include <array>
#include <bitset>
#include <cstdint>
#include <utility>

#include "remembered.hpp"

namespace mcu {

// The processor's mask registers.
struct Masks {
  uint32_t primask, basepri, faultmask;
};

class Nvic {
 public:
  enum Exception {
    NMI = 2,
    HARD_FAULT = 3,
    MEMORY_FAULT = 4,
    BUS_FAULT = 5,
    USAGE_FAULT = 6,
    SVCALL = 11,
    PENDSV = 14,
    SYSTICK = 15,
    EXTERNAL = 16
  };
  static constexpr int MAX_EXCEPTIONS = 256;
  static constexpr int LOWEST = 256;  // priority of code that is no handler

  Nvic(int interrupts, int priority_bits)
      : exceptions_(EXTERNAL + interrupts), priority_mask_(0xff << (8 - priority_bits) & 0xff) {
    for (int n = 0; n < EXTERNAL; ++n) enabled_[n] = true;
    priority_[1] = -3;
    priority_[NMI] = -2;
    priority_[HARD_FAULT] = -1;
  }

  int exceptions() const { return exceptions_; }
  bool is_enabled(int n) const { return enabled_[n]; }
  bool is_pending(int n) const { return pending_[n]; }
  bool is_active(int n) const { return active_[n]; }
  uint32_t priority(int n) const { return static_cast<uint32_t>(priority_[n]); }

  void enable(int n, bool on) {
    if (n >= exceptions_) return;
    enabled_[n] = on;
    changed_ = true;
  }
  void set_pending(int n, bool on = true) {
    if (n >= exceptions_) return;
    pending_[n] = on;
    if (on) changed_ = true;
  }
  void set_priority(int n, uint32_t value) {
    if (n >= exceptions_) return;
    priority_[n] = static_cast<int>(value & priority_mask_);
    changed_ = true;
  }
  // Bits of a priority that decide on preemption follow from PRIGROUP.
  void set_group(uint32_t prigroup) {
    group_mask_ = static_cast<int>(0xff & ~((2u << prigroup) - 1));
    changed_ = true;
  }

  // A device requests its interrupt until it withdraws the request.
  void set_line(int n, bool high) {
    if (high && !line_[n]) set_pending(n);
    line_[n] = high;
  }

  void enter(int n) {
    pending_[n] = false;
    active_[n] = true;
  }
  void leave(int n) {
    active_[n] = false;
    if (line_[n]) pending_[n] = true;
    changed_ = true;
  }

  // Whether a change may let an exception enter; reading clears it.
  bool take_change() { return std::exchange(changed_, false); }

  void visit_state(Checkpoint& list) {
    list(group_mask_, changed_, enabled_, pending_, active_, line_, priority_);
  }

  // The pending exception of highest priority, 0: none.
  int first() const {
    int best = 0;
    if (pending_.none()) return best;
    for (int n = 1; n < exceptions_; ++n)
      if (pending_[n] && enabled_[n] && (!best || order(n) < order(best))) best = n;
    return best;
  }

  int running() const {
    int lowest = LOWEST;
    if (active_.none()) return lowest;
    for (int n = 1; n < exceptions_; ++n)
      if (active_[n]) lowest = std::min(lowest, group(n));
    return lowest;
  }

  // Whether an exception may enter now.
  bool may_enter(int n, const Masks& masks) const {
    int now = running();
    if (masks.faultmask & 1) now = std::min(now, -1);
    if (masks.primask & 1) now = std::min(now, 0);
    return group(n) < under(now, masks.basepri);
  }
  // Whether it ends a sleep, as if PRIMASK were 0.
  bool can_wake_processor(int n, const Masks& masks) const {
    return may_enter(n, {0, masks.basepri, masks.faultmask});
  }

 private:
  int group(int n) const { return priority_[n] < 0 ? priority_[n] : priority_[n] & group_mask_; }
  int order(int n) const { return priority_[n] * MAX_EXCEPTIONS + n; }
  int under(int now, uint32_t basepri) const {
    const int level = static_cast<int>(basepri & priority_mask_);
    return level ? std::min(now, level & group_mask_) : now;
  }

  int exceptions_;
  uint32_t priority_mask_;
  int group_mask_ = 0xff;
  bool changed_ = false;
  std::bitset<MAX_EXCEPTIONS> enabled_, pending_, active_, line_;
  std::array<int, MAX_EXCEPTIONS> priority_{};
};

}  // namespace mcu
