// A joint without a motor, which swings freely.
#pragma once

#include "numerics/real.hpp"
#include "parts/command.hpp"

namespace arm {

struct NoMotor {
  constexpr bool operator==(const NoMotor&) const = default;

  static constexpr bool present = false;
  static constexpr int states = 0, modes = 0;
  static constexpr Real Mm = 0.0;
  static constexpr Command takes = Command::voltage;
  constexpr const NoMotor& linear() const { return *this; }
  constexpr Real largest_current() const { return 0.0; }
};

}  // namespace arm
