// A serial line: status, data and control register with the bits of an STM32. Bytes take their
// time.
#pragma once

#include <unistd.h>

#include <cstring>
#include <deque>

#include "clock.hpp"
#include "registers.hpp"
#include "runner.h"

namespace mcu {

class Uart {
 public:
  static constexpr uint32_t RECEIVED = 1 << 5, SENT = 1 << 6, EMPTY = 1 << 7, OVERRUN = 1 << 3;

  Uart(const mcu_uart& description, double clock, const Time& now, Registers& registers)
      : description_(description),
        byte_(static_cast<Time>(10 / description.baud * clock * CYCLE)),
        now_(now),
        registers_(registers) {
    registers.word(description.status) = EMPTY | SENT;
    registers.set_write_handler(description.status,
                                [](uint32_t, uint32_t stored) { return stored; });
    registers.set_write_handler(description.control,
                                [](uint32_t value, uint32_t) { return value; });
    registers.set_read_handler(description.data, [this](uint32_t stored, bool look) {
      if (!look) registers_.word(description_.status) &= ~(RECEIVED | OVERRUN);
      return stored;
    });
    registers.set_write_handler(description.data, [this](uint32_t value, uint32_t stored) {
      send(static_cast<uint8_t>(value));
      return stored;
    });
  }

  int interrupt() const { return description_.interrupt; }
  bool asks() const {
    return registers_.word(description_.status) & registers_.word(description_.control) &
           (RECEIVED | SENT | EMPTY);
  }

  Time next() const {
    const Time in = arrives_.empty() ? NEVER : next_in_;
    return in < sent_ ? in : sent_;
  }

  void advance(Time now) {
    uint32_t& status = registers_.word(description_.status);
    while (!arrives_.empty() && now >= next_in_) {
      if (status & RECEIVED) status |= OVERRUN;
      registers_.word(description_.data) = arrives_.front();
      arrives_.pop_front();
      status |= RECEIVED;
      next_in_ += byte_;
    }
    if (now >= sent_) {
      status |= EMPTY | SENT;
      sent_ = NEVER;
    }
  }

  // Whether bytes go out to, or come from, somewhere that no checkpoint takes back.
  bool is_wired() const { return description_.out >= 0 || description_.in >= 0; }

  void visit_state(Checkpoint& list) { list(arrives_, next_in_, sent_); }

  // Read typed input.
  void listen() {
    if (description_.in < 0 || arrives_.size() >= MAX_WAITING) return;
    uint8_t bytes[256];
    const ssize_t heard = ::read(description_.in, bytes, sizeof bytes);
    for (ssize_t k = 0; k < heard; ++k) receive(bytes[k]);
  }

  // Joint targets: 0xa5, 0x5a, a float per joint, low byte of the sum of their bytes.
  bool has_targets() const { return description_.targets; }
  void send_targets(const double* q, int joints) {
    receive(0xa5);
    receive(0x5a);
    uint8_t sum = 0;
    for (int j = 0; j < joints; ++j) {
      const float number = static_cast<float>(q[j]);
      uint8_t bytes[4];
      std::memcpy(bytes, &number, 4);
      for (const uint8_t byte : bytes) {
        receive(byte);
        sum = static_cast<uint8_t>(sum + byte);
      }
    }
    receive(sum);
  }

 private:
  static constexpr size_t MAX_WAITING = 4096;  // bytes that wait

  void receive(uint8_t byte) {
    if (arrives_.empty()) next_in_ = (next_in_ > now_ ? next_in_ : now_) + byte_;
    arrives_.push_back(byte);
  }

  void send(uint8_t byte) {
    // Bytes that are not read are lost, and the firmware does not notice: as on a wire.
    if (description_.out >= 0) static_cast<void>(::write(description_.out, &byte, 1) < 0);
    registers_.word(description_.status) &= ~(EMPTY | SENT);
    sent_ = now_ + byte_;
  }

  mcu_uart description_;
  Time byte_;
  const Time& now_;
  Registers& registers_;
  std::deque<uint8_t> arrives_;
  Time next_in_ = 0, sent_ = NEVER;
};

}  // namespace mcu
