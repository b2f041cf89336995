// The entries of the object dictionary that a master on EtherCAT finds.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "../object_dictionary.hpp"

namespace ethercat {

namespace abort_code = fieldbus::abort_code;
using fieldbus::Entry;

// The entries of an object, none if there is no such object.
inline std::span<const Entry> object(std::uint16_t index) {
  const int first = fieldbus::slot_of(index, 0);
  if (first < 0) return {};
  const auto from = fieldbus::kEntries.subspan(static_cast<std::size_t>(first));
  if (!from[0].on(fieldbus::Bus::ethercat)) return {};
  return from.first(from[0].last_sub + std::size_t{1});
}
// The indices of all objects, ascending.
inline std::vector<std::uint16_t> all_objects() {
  std::vector<std::uint16_t> out;
  for (const Entry& one : fieldbus::kEntries)
    if (one.sub == 0 && one.on(fieldbus::Bus::ethercat)) out.push_back(one.index);
  return out;
}

}  // namespace ethercat
