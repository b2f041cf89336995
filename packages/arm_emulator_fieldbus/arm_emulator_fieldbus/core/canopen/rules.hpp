// Rules of CiA 301 about the objects of the communication that no range of values expresses.
#pragma once

#include "../object_dictionary.hpp"

namespace fieldbus::canopen {

// Bits of a COB-ID.
inline constexpr std::int64_t kInvalid = std::int64_t{1} << 31, kNoRemote = std::int64_t{1} << 30,
                              kExtended = std::int64_t{1} << 29, kIdentifier = 0x7FF;
inline constexpr std::int64_t kLargestNode = 127;

constexpr bool is_communication(std::uint16_t index) {  // of a PDO
  return (index >= 0x1400 && index < 0x1600) || (index >= 0x1800 && index < 0x1A00);
}
constexpr bool is_mapping(std::uint16_t index) {
  return (index >= 0x1600 && index < 0x1800) || (index >= 0x1A00 && index < 0x1C00);
}
// Identifiers that CiA 301 keeps for itself.
constexpr bool is_restricted(std::int64_t id) {
  struct Range {
    std::int64_t low, high;
  };
  constexpr Range reserved[] = {{0x000, 0x07F}, {0x101, 0x180}, {0x581, 0x5FF},
                                {0x601, 0x67F}, {0x6E0, 0x6FF}, {0x701, 0x7FF}};
  for (const Range& one : reserved)
    if (id >= one.low && id <= one.high) return true;
  return false;
}

// Whether a COB-ID may be given to an entry that has another one now.
constexpr std::uint32_t check_identifier(const Entry& one, std::int64_t value, std::int64_t now) {
  const bool of_pdo = is_communication(one.index);
  if (value & (kExtended | 0x1FFFF800)) return abort_code::out_of_range;
  if (one.index == 0x1005 && value >> 29) return abort_code::out_of_range;
  if (!(value & kInvalid) && is_restricted(value & kIdentifier)) return abort_code::out_of_range;
  const bool moved = ((value ^ now) & ~(kInvalid | kNoRemote)) != 0;
  const bool in_use = !((value | now) & kInvalid);
  return of_pdo && moved && in_use ? abort_code::state : abort_code::none;
}
// The same for a value of any entry.
constexpr std::uint32_t check(const Entry& one, std::int64_t value, std::int64_t now) {
  const bool of_pdo = is_communication(one.index);
  if (one.index == 0x1005 || one.index == 0x1014 || (of_pdo && one.sub == 1))
    return check_identifier(one, value, now);
  const std::int64_t asynchronous = one.index >= 0x1800 ? 252 : 254;  // transmission types
  if (of_pdo && one.sub == 2 && value > 240 && value < asynchronous)
    return abort_code::out_of_range;
  if (one.index == 0x1016 && one.sub && value & 0xFFFF && value >> 16 > kLargestNode)
    return abort_code::out_of_range;
  return abort_code::none;
}

}  // namespace fieldbus::canopen
