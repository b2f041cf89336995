// Pins: output registers with their registers that set and clear bits, and what is wired to them.
#pragma once

#include "registers.hpp"
#include "runner.h"

namespace mcu {

inline void add_port(const mcu_port& port, Registers& registers) {
  uint32_t* output = &registers.word(port.output);
  if (port.set_reset)
    registers.set_write_handler(port.set_reset, [output](uint32_t value, uint32_t) {
      *output = (*output & ~(value >> 16)) | (value & 0xffff);
      return 0u;
    });
  if (port.set)
    registers.set_write_handler(port.set, [output](uint32_t value, uint32_t) {
      *output |= value;
      return 0u;
    });
  if (port.clear)
    registers.set_write_handler(port.clear, [output](uint32_t value, uint32_t) {
      *output &= ~value;
      return 0u;
    });
}

class Pin {
 public:
  Pin(const mcu_pin& description, Registers& registers)
      : description_(description), registers_(registers) {}

  int kind() const { return description_.kind; }
  bool is_of(int joint) const { return description_.joint < 0 || description_.joint == joint; }
  bool is_output() const {
    return description_.kind == MCU_ENABLE || description_.kind == MCU_BRAKE;
  }

  bool is_on() {
    return (registers_.word(description_.at) >> description_.bit & 1) != (description_.low != 0);
  }

  void measure(const arm_measurement& measured, int joints) {
    bool on = measured.powered;
    if (description_.kind == MCU_FAULT) {
      on = false;
      for (int j = 0; j < joints; ++j)
        if (is_of(j) && measured.joint[j].faults) on = true;
    }
    uint32_t& word = registers_.word(description_.at);
    const uint32_t bit = 1u << description_.bit;
    word = on != (description_.low != 0) ? word | bit : word & ~bit;
  }

 private:
  mcu_pin description_;
  Registers& registers_;
};

}  // namespace mcu
