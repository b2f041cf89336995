// Variables of a unit: a table in the order of their value references, written by the exporter
// (variables.py) from the same list as modelDescription.xml.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>
#include <type_traits>
#include <utility>

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

// Where value `k` of a place stands in the data.
template <class Data>
const unsigned char* place_in(const Data& data, const Place& place, int k) {
  return reinterpret_cast<const unsigned char*>(&data) + place.offset +
         static_cast<std::size_t>(k) * place.stride;
}
template <class Data>
unsigned char* place_in(Data& data, const Place& place, int k) {
  return const_cast<unsigned char*>(place_in(std::as_const(data), place, k));
}

template <class To, class From>
To value_as(const unsigned char* at) {
  From value;
  std::memcpy(&value, at, sizeof value);
  if constexpr (std::is_same_v<To, bool>) return value != From{};
  return static_cast<To>(value);
}
// And the value itself.
template <class To, class Data>
To value_at(const Data& data, const Place& place, int k) {
  const unsigned char* at = place_in(data, place, k);
  switch (place.wire) {
    case Wire::float64:
      return value_as<To, double>(at);
    case Wire::int64:
      return value_as<To, std::int64_t>(at);
    case Wire::int32:
      return value_as<To, std::int32_t>(at);
    case Wire::uint32:
      return value_as<To, std::uint32_t>(at);
    default:
      return value_as<To, unsigned char>(at);
  }
}

struct Variable {
  Type type;
  Role role;
  Rule rule;
  bool truth;  // which only the emulator knows
  Place place;
  int first, count;  // of its joints or parameters; how many values it has
};

}  // namespace fmu
