// A timer that counts an encoder's lines: CNT of 16 or 32 bits.
#pragma once

#include <memory>

#include "registers.hpp"
#include "runner.h"

namespace mcu {

class TimerEncoder {
 public:
  TimerEncoder(const mcu_encoder& description, Registers& registers)
      : description_(description),
        mask_(description.bits == 32 ? ~0u : (1u << description.bits) - 1),
        registers_(registers) {
    // Firmware sets the initial count.
    registers.set_write_handler(description.at, [this](uint32_t value, uint32_t) {
      offset_ = (value - counts_) & mask_;
      return value & mask_;
    });
  }

  void measure(const arm_measurement& measured) {
    counts_ = static_cast<uint32_t>(measured.joint[description_.joint].encoder);
    registers_.word(description_.at) = (counts_ + offset_) & mask_;
  }

  void visit_state(Checkpoint& list) { list(counts_, offset_); }

 private:
  mcu_encoder description_;
  uint32_t mask_;
  Registers& registers_;
  uint32_t counts_ = 0, offset_ = 0;
};

}  // namespace mcu
