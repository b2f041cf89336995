// An analog-to-digital converter that is triggered when a servo period begins, and signals its end.
#pragma once

#include <cmath>
#include <vector>

#include "nvic.hpp"
#include "registers.hpp"
#include "runner.h"

namespace mcu {

class Adc {
 public:
  Adc(const mcu_adc& description, Registers& registers)
      : description_(description), registers_(registers) {
    if (!description.status) return;
    registers.set_write_handler(description.status, [this](uint32_t value, uint32_t stored) {
      const uint32_t flag = 1u << description_.flag;
      const bool keeps = description_.clear_by_one ? !(value & flag) : value & flag;
      return (value & ~flag) | (keeps ? stored & flag : 0);
    });
    if (description.control)
      registers.set_write_handler(description.control,
                                  [](uint32_t value, uint32_t) { return value; });
  }

  void add(const mcu_channel& channel) { channels_.push_back(channel); }

  void convert(const arm_measurement& measured) {
    for (const mcu_channel& one : channels_) {
      const double current = measured.joint[one.joint].current;
      if (one.bits)
        registers_.word(one.at) = counts(one, current);
      else
        registers_.put(one.at, static_cast<float>(current));
    }
    if (description_.status) registers_.word(description_.status) |= 1u << description_.flag;
  }

  int interrupt() const { return description_.interrupt; }
  bool asks() const {
    return description_.status && (registers_.word(description_.status) >> description_.flag & 1) &&
           (!description_.control ||
            (registers_.word(description_.control) >> description_.enable & 1));
  }

 private:
  static uint32_t counts(const mcu_channel& one, double current) {
    const double value = std::floor(current * one.counts_per_ampere + one.offset + 0.5);
    const double full_scale = static_cast<double>((1ll << one.bits) - 1);
    return value > 0 ? static_cast<uint32_t>(value < full_scale ? value : full_scale) : 0;
  }

  mcu_adc description_;
  Registers& registers_;
  std::vector<mcu_channel> channels_;
};

}  // namespace mcu
