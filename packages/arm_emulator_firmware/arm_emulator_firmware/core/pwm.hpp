// Compare registers of a timer as the voltage of a motor's bridge.
#pragma once

#include "registers.hpp"
#include "runner.h"

namespace mcu {

class Pwm {
 public:
  Pwm(const mcu_pwm& description, Registers& registers)
      : description_(description), registers_(registers) {}

  int joint() const { return description_.joint; }

  double voltage() {
    switch (description_.kind) {
      case MCU_BIPOLAR:
        return is_running() ? description_.full_scale * (2 * compute_duty(description_.compare) - 1)
                            : 0;
      case MCU_UNIPOLAR: {
        const bool negative =
            registers_.word(description_.direction) >> description_.direction_bit & 1;
        const double size = description_.full_scale * compute_duty(description_.compare);
        return negative ? -size : size;
      }
      case MCU_PAIR:
        return description_.full_scale *
               (compute_duty(description_.compare) - compute_duty(description_.minus));
      default:
        return registers_.number(description_.compare);
    }
  }

 private:
  bool is_running() { return registers_.word(description_.reload) != 0; }
  double compute_duty(uint32_t compare) {
    if (!is_running()) return 0;
    const double top =
        registers_.word(description_.reload) + static_cast<double>(description_.counts_more);
    const double share = registers_.word(compare) / top;
    return share < 1 ? share : 1;
  }

  mcu_pwm description_;
  Registers& registers_;
};

}  // namespace mcu
