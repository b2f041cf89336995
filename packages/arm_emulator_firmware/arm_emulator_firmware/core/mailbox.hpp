// Joint targets in registers: a float per joint, and how often they have come.
#pragma once

#include <vector>

#include "registers.hpp"
#include "runner.h"

namespace mcu {

class Mailbox {
 public:
  Mailbox(const mcu_mailbox& description, int joints, Registers& registers)
      : description_(description),
        at_(description.at, description.at + joints),
        registers_(registers) {}

  int interrupt() const { return description_.interrupt; }

  void put(const double* q) {
    for (size_t j = 0; j < at_.size(); ++j)
      if (at_[j]) registers_.put(at_[j], static_cast<float>(q[j]));
    ++registers_.word(description_.count);
  }

 private:
  mcu_mailbox description_;
  std::vector<uint32_t> at_;
  Registers& registers_;
};

}  // namespace mcu
