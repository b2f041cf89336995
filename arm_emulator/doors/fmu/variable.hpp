// Variables of a unit: a table in the order of their value references, written by the exporter
// (variables.py) from the same list as modelDescription.xml.
#pragma once

#include <cstddef>
#include <cstdint>

namespace fmu {

enum class Type { float64, int64, int32, boolean };

enum class Role {
  independent,  // time
  fixed,        // a parameter that is set before the motion begins
  tunable,      // a parameter that may be set between two steps
  input,
  output
};

// Rule for a value; `at` counts from Variable::first.
enum class Rule { finite, command, further, wrench, start_q, start_v, parameter };

// Type in memory.
enum class Wire { float64, int64, int32, uint32, byte };
template <class Value>
constexpr Wire kWire = Wire::float64;
template <>
inline constexpr Wire kWire<std::int64_t> = Wire::int64;
template <>
inline constexpr Wire kWire<std::int32_t> = Wire::int32;
template <>
inline constexpr Wire kWire<std::uint32_t> = Wire::uint32;
template <>
inline constexpr Wire kWire<unsigned char> = Wire::byte;

// A place of `struct Data` (data.hpp).
struct Place {
  Wire wire;
  std::size_t offset;  // of the first value
  std::size_t stride;  // from one value to the next
};

struct Variable {
  Type type;
  Role role;
  Rule rule;
  bool truth;  // which only the emulator knows
  Place place;
  int first, count;  // of its joints or parameters; how many values it has
};

}  // namespace fmu
