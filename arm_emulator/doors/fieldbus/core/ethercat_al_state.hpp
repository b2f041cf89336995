// The state machine of a slave (ETG.1000.6, section 6.4): INIT, PREOP, SAFEOP, OP. Each step up is
// asked for by the master and checked; whatever goes wrong is told with a code, and stays told
// until the master acknowledges it.
#pragma once

#include <cstdint>

#include "ethercat_registers.hpp"

namespace ethercat {

enum class State : std::uint8_t { INIT = 1, PREOP = 2, BOOT = 3, SAFEOP = 4, OP = 8 };

// ETG.1000.6, table 11.
enum class AlCode : std::uint16_t {
  NONE = 0x0000,
  INVALID_CHANGE = 0x0011,
  UNKNOWN_STATE = 0x0012,
  NO_BOOTSTRAP = 0x0013,
  MAILBOX = 0x0016,
  WATCHDOG = 0x001b,
  OUTPUTS = 0x001d,
  INPUTS = 0x001e,
  SYNC0_CYCLE = 0x0036
};

class AlState {
 public:
  explicit AlState(Memory& memory) : memory(memory) { tell(); }

  State state() const { return state_; }
  bool error() const { return code != AlCode::NONE; }

  // The master has written to AL control. `enter(to)` does and checks a step from `state()`.
  template <class Enter>
  void request(Enter enter) {
    const std::uint16_t control = memory.get16(reg::kAlControl);
    const bool acknowledges = control & 0x10;
    if (error() && !acknowledges) return;
    code = AlCode::NONE;
    const auto wanted = static_cast<State>(control & 0x0f);
    const auto now = static_cast<int>(state_), then = control & 0x0f;
    if (wanted == State::BOOT)
      code = AlCode::NO_BOOTSTRAP;
    else if (then != 1 && then != 2 && then != 4 && then != 8)
      code = AlCode::UNKNOWN_STATE;
    else if (then > 2 * now)
      code = AlCode::INVALID_CHANGE;
    else if (then != now)
      code = enter(wanted);
    if (code == AlCode::NONE) state_ = wanted;
    tell();
  }
  // Something went wrong.
  void set(State to, AlCode why) {
    state_ = to;
    code = why;
    tell();
  }

 private:
  void tell() {
    const unsigned flag = error() ? 0x10u : 0;
    memory.put16(reg::kAlStatus, static_cast<std::uint16_t>(static_cast<unsigned>(state_) | flag));
    memory.put16(reg::kAlCode, static_cast<std::uint16_t>(code));
    memory.put16(reg::kEvents, memory.get16(reg::kEvents) | event::kAlStatus);
  }

  Memory& memory;
  State state_ = State::INIT;
  AlCode code = AlCode::NONE;
};

}  // namespace ethercat
