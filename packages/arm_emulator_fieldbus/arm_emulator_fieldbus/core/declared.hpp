// Inputs and outputs that parts declare, as objects of every drive. The lists of them, kTaken and
// kReported, ascending by index, are written from the declarations (declared.py) and stand before
// object_dictionary.hpp.
#pragma once

#include <array>
#include <bit>
#include <concepts>
#include <iterator>

#include "drives.h"
#include "object_entry.hpp"

namespace fieldbus {

// Subs of an object of inertial measurement units: x, y, z of each unit on the drive's link.
inline constexpr int kAxes = 3, kUnitValues = kAxes * DRIVES_UNITS;
inline constexpr const char* kUnitValueNames[] = {"Unit 1, x", "Unit 1, y", "Unit 1, z",
                                                  "Unit 2, x", "Unit 2, y", "Unit 2, z"};
static_assert(std::size(kUnitValueNames) == kUnitValues);

// A value in the bits of its object.
constexpr std::int64_t word(double value) {
  return std::bit_cast<std::uint32_t>(static_cast<float>(value));
}
constexpr std::int64_t word(std::integral auto value) { return static_cast<std::int64_t>(value); }

constexpr float real(std::int64_t word) {
  return std::bit_cast<float>(static_cast<std::uint32_t>(word));
}

// Place of a joint's value: its place `joint` in a row of `joints`, and `row`, that of an output in
// an array of rows or an inertial measurement unit. `axis` is an axis of that unit.
struct Place {
  int joints = 0, joint = 0, row = 0, axis = 0;
  int in_rows() const { return row * joints + joint; }
};

// A further input of motors.
struct Taken {
  std::uint16_t index;
  const char *name, *unit;
};

// An output.
struct Reported {
  std::uint16_t index;
  const char *name, *unit;
  Type type;
  bool per_unit;
  std::int64_t (*value)(const arm_measurement& all, Place at);
};

}  // namespace fieldbus
