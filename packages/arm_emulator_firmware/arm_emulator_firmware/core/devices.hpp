// The devices of a board and the registers before them: measurements go in, commands come out.
#pragma once

#include <algorithm>
#include <deque>
#include <limits>
#include <optional>
#include <set>
#include <vector>

#include "adc.hpp"
#include "clock.hpp"
#include "gpio.hpp"
#include "mailbox.hpp"
#include "nvic.hpp"
#include "pwm.hpp"
#include "registers.hpp"
#include "runner.h"
#include "timer_encoder.hpp"
#include "uart.hpp"

namespace mcu {

class Devices {
 public:
  Registers registers;

  Devices(const mcu_board& board, Nvic& nvic, const Time& now)
      : board_(board), nvic_(nvic), now_(now) {}

  // Set registers and devices as after a reset.
  void connect_devices() {
    has_sent_ = false;
    registers = {};
    encoders_.clear(), adcs_.clear(), pins_.clear(), pwms_.clear(), uarts_.clear();
    for (int k = 0; k < board_.regions; ++k)
      if (const mcu_region& one = board_.region[k]; one.kind == MCU_REGISTERS)
        registers.add(one.at, one.size);
    for (int k = 0; k < board_.words; ++k) {
      const mcu_word word = board_.word[k];
      registers.word(word.at) = word.value;
      if (word.fixed)
        registers.set_read_handler(word.at, [word](uint32_t stored, bool) {
          return (stored & ~word.fixed) | (word.value & word.fixed);
        });
    }
    for (int k = 0; k < board_.encoders; ++k) encoders_.emplace_back(board_.encoder[k], registers);
    for (int k = 0; k < board_.adcs; ++k) adcs_.emplace_back(board_.adc[k], registers);
    for (int k = 0; k < board_.channels; ++k)
      adcs_[static_cast<size_t>(board_.channel[k].adc)].add(board_.channel[k]);
    for (int k = 0; k < board_.ports; ++k) add_port(board_.port[k], registers);
    for (int k = 0; k < board_.pins; ++k) pins_.emplace_back(board_.pin[k], registers);
    for (int k = 0; k < board_.pwms; ++k) pwms_.emplace_back(board_.pwm[k], registers);
    for (int k = 0; k < board_.uarts; ++k)
      uarts_.emplace_back(board_.uart[k], board_.clock, now_, registers);
    for (const Adc& adc : adcs_)
      if (adc.interrupt() >= 0) lines_.insert(adc.interrupt());
    for (const Uart& uart : uarts_)
      if (uart.interrupt() >= 0) lines_.insert(uart.interrupt());
    if (board_.mailbox) mailbox_.emplace(*board_.mailbox, board_.joints, registers);
  }

  // Levels of interrupt lines follow what registers hold.
  void set_lines() {
    for (const int interrupt : lines_) {
      bool high = false;
      for (const Adc& adc : adcs_) high |= adc.interrupt() == interrupt && adc.asks();
      for (const Uart& uart : uarts_) high |= uart.interrupt() == interrupt && uart.asks();
      nvic_.set_line(Nvic::EXTERNAL + interrupt, high);
    }
  }

  void measure(const firmware_input& in, bool convert) {
    for (TimerEncoder& encoder : encoders_) encoder.measure(*in.measured);
    for (Pin& pin : pins_)
      if (!pin.is_output()) pin.measure(*in.measured, board_.joints);
    if (!convert) return;
    for (Adc& adc : adcs_) adc.convert(*in.measured);
    if (in.q_target) {
      if (mailbox_) {
        mailbox_->put(in.q_target);
        if (mailbox_->interrupt() >= 0) nvic_.set_pending(Nvic::EXTERNAL + mailbox_->interrupt());
      }
      for (Uart& uart : uarts_)
        if (uart.has_targets() && (in.new_row || !has_sent_))
          uart.send_targets(in.q_target, board_.joints);
      has_sent_ = true;
    }
    for (Uart& uart : uarts_) uart.listen();
  }

  void command(firmware_output& out) {
    for (Pwm& pwm : pwms_) out.joint[pwm.joint()].value = pwm.voltage();
    for (int j = 0; j < board_.joints; ++j) {
      uint32_t enable = ARM_ENABLED;
      for (Pin& pin : pins_)
        if (pin.is_of(j)) {
          if (pin.kind() == MCU_ENABLE && !pin.is_on())
            enable &= ~static_cast<uint32_t>(ARM_ENABLED);
          if (pin.kind() == MCU_BRAKE && pin.is_on()) enable |= ARM_CLOSE_BRAKE;
        }
      out.joint[j].enable = enable;
    }
  }

  Time next() const {
    Time next = std::numeric_limits<Time>::max();
    for (const Uart& uart : uarts_) next = std::min(next, uart.next());
    return next;
  }

  void advance(Time now) {
    for (Uart& uart : uarts_) uart.advance(now);
    set_lines();
  }

  bool is_wired() const {
    return std::any_of(uarts_.begin(), uarts_.end(),
                       [](const Uart& one) { return one.is_wired(); });
  }

  void visit_state(Checkpoint& list) {
    registers.visit_state(list);
    for (TimerEncoder& encoder : encoders_) encoder.visit_state(list);
    for (Uart& uart : uarts_) uart.visit_state(list);
    list(has_sent_);
  }

 private:
  const mcu_board& board_;
  Nvic& nvic_;
  const Time& now_;
  std::deque<TimerEncoder> encoders_;  // registers keep pointers to them
  std::deque<Adc> adcs_;
  std::deque<Uart> uarts_;
  std::vector<Pin> pins_;
  std::vector<Pwm> pwms_;
  std::optional<Mailbox> mailbox_;
  std::set<int> lines_;    // interrupts that devices ask for
  bool has_sent_ = false;  // targets since the reset
};

}  // namespace mcu
