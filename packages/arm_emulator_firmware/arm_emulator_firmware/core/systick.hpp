// SysTick: the processor's own timer, counting down from LOAD (ARMv7-M, B3.3).
#pragma once

#include "clock.hpp"
#include "nvic.hpp"

namespace mcu {

class SysTick {
 public:
  explicit SysTick(Nvic& nvic) : nvic_(nvic) {}

  Time next() const { return is_enabled() ? zero_ : NEVER; }

  void advance(Time now) {
    if (!is_enabled() || now < zero_) return;
    counted_ = true;
    if (control_ & 2) nvic_.set_pending(Nvic::SYSTICK);
    zero_ += (now - zero_) / period() * period() + period();
  }

  uint32_t control(bool look) {
    const uint32_t value = control_ | (counted_ ? 1u << 16 : 0);
    if (!look) counted_ = false;
    return value;
  }
  void set_control(uint32_t value, Time now) {
    const bool was = is_enabled();
    const Time left = was ? zero_ - now : 0;
    control_ = value & 7;
    if (was && !is_enabled()) left_ = left / unit();
    if (!was && is_enabled()) zero_ = now + (left_ > 0 ? left_ * unit() : period());
  }

  uint32_t load() const { return load_; }
  void set_load(uint32_t value) { load_ = value & 0xffffff; }

  uint32_t value(Time now) const {
    if (!is_enabled()) return static_cast<uint32_t>(left_);
    const Time left = (zero_ - now) / unit();
    return static_cast<uint32_t>(left < 0 ? 0 : left > load_ ? load_ : left);
  }
  // Any write clears it, and counting begins at LOAD.
  void clear_value(Time now) {
    counted_ = false;
    left_ = 0;
    zero_ = now + period();
  }

  void visit_state(Checkpoint& list) { list(control_, load_, left_, zero_, counted_); }

 private:
  bool is_enabled() const { return (control_ & 1) && load_; }
  // The reference clock is an eighth of the processor's.
  Time unit() const { return control_ & 4 ? CYCLE : 8 * CYCLE; }
  Time period() const { return (static_cast<Time>(load_) + 1) * unit(); }

  Nvic& nvic_;
  uint32_t control_ = 0, load_ = 0;
  Time left_ = 0;  // while it stands still, in its units
  Time zero_ = 0;  // when it comes to 0
  bool counted_ = false;
};

}  // namespace mcu
