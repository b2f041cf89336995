// Compare registers of a timer as the voltage of a motor's bridge.
#pragma once

#include "registers.hpp"
#include "runner.h"

namespace mcu {

class Pwm {
 public:
  Pwm(const mcu_pwm& told, Registers& registers) : told_(told), registers_(registers) {}

  int joint() const { return told_.joint; }

  double voltage() {
    switch (told_.kind) {
      case MCU_BIPOLAR:
        return runs() ? told_.full_scale * (2 * duty(told_.compare) - 1) : 0;
      case MCU_UNIPOLAR: {
        const bool negative = registers_.word(told_.direction) >> told_.direction_bit & 1;
        const double size = told_.full_scale * duty(told_.compare);
        return negative ? -size : size;
      }
      case MCU_PAIR:
        return told_.full_scale * (duty(told_.compare) - duty(told_.minus));
      default:
        return registers_.number(told_.compare);
    }
  }

 private:
  bool runs() { return registers_.word(told_.reload) != 0; }
  double duty(uint32_t compare) {
    if (!runs()) return 0;
    const double top = registers_.word(told_.reload) + static_cast<double>(told_.counts_more);
    const double share = registers_.word(compare) / top;
    return share < 1 ? share : 1;
  }

  mcu_pwm told_;
  Registers& registers_;
};

}  // namespace mcu
