// The state machine of a slave (ETG.1000.6, section 6.4): INIT, PREOP, SAFEOP, OP. The master
// requests each step up, which is checked; an error is reported with a code until the master
// acknowledges it.
#pragma once

#include <cstdint>

#include "registers.hpp"

namespace ethercat {

enum class State : std::uint8_t { init = 1, preop = 2, boot = 3, safeop = 4, op = 8 };

// ETG.1000.6, table 11.
enum class AlCode : std::uint16_t {
  none = 0x0000,
  invalid_change = 0x0011,
  unknown_state = 0x0012,
  no_bootstrap = 0x0013,
  mailbox = 0x0016,
  watchdog = 0x001b,
  outputs = 0x001d,
  inputs = 0x001e,
  syn_c0_cycle = 0x0036
};

class AlState {
 public:
  explicit AlState(Memory& memory) : memory_(memory) { report(); }

  State state() const { return state_; }
  bool error() const { return code_ != AlCode::none; }

  // The master has written to AL control. `enter(to)` does and checks a step from `state()`.
  template <class Enter>
  void request(Enter enter) {
    const std::uint16_t control = memory_.get16(reg::kAlControl);
    const bool acknowledges = control & 0x10;
    if (error() && !acknowledges) return;
    code_ = AlCode::none;
    const auto target = static_cast<State>(control & 0x0f);
    const auto now = static_cast<int>(state_), then = control & 0x0f;
    if (target == State::boot)
      code_ = AlCode::no_bootstrap;
    else if (then != 1 && then != 2 && then != 4 && then != 8)
      code_ = AlCode::unknown_state;
    else if (then > 2 * now)
      code_ = AlCode::invalid_change;
    else if (then != now)
      code_ = enter(target);
    if (code_ == AlCode::none) state_ = target;
    report();
  }
  // An error occurred.
  void set(State to, AlCode why) {
    state_ = to;
    code_ = why;
    report();
  }

 private:
  void report() {
    const unsigned flag = error() ? 0x10u : 0;
    memory_.put16(reg::kAlStatus, static_cast<std::uint16_t>(static_cast<unsigned>(state_) | flag));
    memory_.put16(reg::kAlCode, static_cast<std::uint16_t>(code_));
    memory_.put16(reg::kEvents, memory_.get16(reg::kEvents) | event::kAlStatus);
  }

  Memory& memory_;
  State state_ = State::init;
  AlCode code_ = AlCode::none;
};

}  // namespace ethercat
