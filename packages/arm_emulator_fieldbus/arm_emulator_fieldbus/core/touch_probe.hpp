// Touch probes: the position at an index pulse of the encoder (0x60B8 to 0x60BC). There is no other
// input that could trigger them, and an index pulse has one edge, the positive one; functions that
// would never trigger are refused.
#pragma once

#include <cstdint>

namespace fieldbus {

class TouchProbe {
 public:
  // Whether a function can trigger, or is off. `function`: as below; `index`: whether the encoder
  // has an index pulse.
  static constexpr bool known(unsigned function, bool index) {
    constexpr unsigned source = 12, index_pulse = 4, negative = 32;
    if (!(function & 1U)) return true;
    return index && (function & source) == index_pulse && !(function & negative);
  }
  // `function`: the eight bits of this probe in 0x60B8. Whether a position was stored now.
  bool look(unsigned function, std::int64_t pulses) {
    const bool on = function & 1U, goes_on = function & 2U, index = function & 4U,
               positive = function & 16U;
    if (!on) {
      stored_ = false;
    } else if (!on_ || !positive) {
      stored_ = stored_ && on_;
      pulses_ = pulses;
    } else if (index && pulses != pulses_ && (goes_on || !stored_)) {
      pulses_ = pulses;
      on_ = stored_ = true;
      return true;
    }
    on_ = on;
    return false;
  }
  // The eight bits of this probe in 0x60B9.
  unsigned status() const { return (on_ ? 1U : 0U) | (stored_ ? 2U : 0U); }

 private:
  bool on_ = false, stored_ = false;
  std::int64_t pulses_ = 0;
};

}  // namespace fieldbus
