// A drive's object dictionary as masters see it on its bus: one entry, or all of an object at once
// (complete access, ETG.1000.6, section 5.6.2).
#pragma once

#include <algorithm>
#include <span>
#include <vector>

#include "drive.hpp"
#include "little_endian.hpp"

namespace fieldbus {

// Object of a transfer.
struct SdoObject {
  std::uint16_t index = 0;
  std::uint8_t sub = 0;
  bool complete = false;  // all entries of the object, from `sub` on
};

// Abort codes are returned; after one, nothing has changed.
class DriveDictionary {
 public:
  explicit DriveDictionary(Drive& drive) : drive_(drive) {}

  std::uint32_t read(const SdoObject& at, Bytes& out) const {
    return at.complete ? read_all(at.index, at.sub, out) : read_sub(at.index, at.sub, out);
  }
  std::uint32_t write(const SdoObject& at, std::span<const std::uint8_t> in) {
    return at.complete ? write_all(at.index, at.sub, in) : write_sub(at.index, at.sub, in);
  }
  // The entries of an object, none if there is no such object.
  std::span<const Entry> object(std::uint16_t index) const {
    const int first = drive_.values().find(index, 0);
    if (first < 0) return {};
    const auto from = kEntries.subspan(static_cast<std::size_t>(first));
    return from.first(from[0].last_sub + std::size_t{1});
  }
  // The indices of all objects, ascending.
  std::vector<std::uint16_t> indices() const {
    std::vector<std::uint16_t> out;
    for (const Entry& one : kEntries)
      if (one.sub == 0 && one.on(drive_.values().bus())) out.push_back(one.index);
    return out;
  }
  // Bytes of a number, where a client does not name them; at most 4.
  std::size_t length(const SdoObject& at) const {
    const int slot = drive_.values().find(at.index, at.sub);
    const std::size_t bits = slot < 0 ? 0 : Values::entry(slot).bits;
    return bits ? bits / 8 : 4;
  }

 private:
  std::uint32_t read_sub(std::uint16_t index, std::size_t sub, Bytes& out) const {
    std::byte value[kLongestText];
    std::size_t size = 0;
    const std::uint32_t abort = drive_.read(index, static_cast<std::uint8_t>(sub), value, size);
    const auto* const from = reinterpret_cast<const std::uint8_t*>(value);
    if (!abort) out.insert(out.end(), from, from + size);
    return abort;
  }
  std::uint32_t write_sub(std::uint16_t index, std::size_t sub, std::span<const std::uint8_t> in) {
    return drive_.write(index, static_cast<std::uint8_t>(sub), std::as_bytes(in));
  }

  // Present number of sub-indices of an object: the value of sub 0, which masters set for mappings
  // and assignments.
  std::size_t count_subindices(std::span<const Entry> entries) const {
    return std::min<std::size_t>(drive_.values().number(entries[0].index, 0), entries.size() - 1);
  }

  std::uint32_t read_all(std::uint16_t index, std::uint8_t from, Bytes& out) const {
    const auto entries = object(index);
    if (entries.empty()) return abort_code::no_object;
    if (from > 1) return abort_code::unsupported;
    if (entries.size() == 1) return from == 0 ? read_sub(index, 0, out) : abort_code::no_sub;
    const std::size_t count = count_subindices(entries);
    if (from == 0) {
      out.push_back(static_cast<std::uint8_t>(count));
      out.push_back(0);  // sub 0 takes 16 bits
    }
    for (std::size_t sub = 1; sub <= count; ++sub) {
      const std::uint32_t abort = read_sub(index, sub, out);
      if (abort != 0) return abort;
    }
    return 0;
  }

  // All or nothing: written entries are restored when a later one is refused.
  std::uint32_t write_all(std::uint16_t index, std::uint8_t from,
                          std::span<const std::uint8_t> data) {
    const auto entries = object(index);
    if (entries.empty()) return abort_code::no_object;
    if (from > 1) return abort_code::unsupported;
    if (entries.size() == 1) return from == 0 ? write_sub(index, 0, data) : abort_code::no_sub;
    const bool counted = entries[0].writable();  // mapping, assignment: sub 0 is 0 meanwhile
    std::vector<Bytes> before(entries.size());
    for (std::size_t sub = 0; sub < entries.size(); ++sub) read_sub(index, sub, before[sub]);
    const std::uint32_t abort = write_subs(entries, from, data, counted);
    if (abort == 0) return 0;
    const std::uint8_t none[1] = {0};
    if (counted) write_sub(index, 0, none);
    for (std::size_t sub = 1; sub < entries.size(); ++sub)
      if (entries[sub].writable()) write_sub(index, sub, before[sub]);
    if (counted) write_sub(index, 0, before[0]);
    return abort;
  }

  std::uint32_t write_subs(std::span<const Entry> entries, std::uint8_t from,
                           std::span<const std::uint8_t> data, bool counted) {
    const std::uint16_t index = entries[0].index;
    std::uint8_t count = static_cast<std::uint8_t>(drive_.values().number(index, 0));
    if (from == 0) {
      if (data.empty()) return abort_code::too_short;
      if (counted) count = data[0];
      data = data.subspan(std::min<std::size_t>(2, data.size()));
    }
    const std::uint8_t none[1] = {0}, total[1] = {count};
    std::uint32_t abort = counted ? write_sub(index, 0, none) : 0;
    for (std::size_t sub = 1; abort == 0 && sub < entries.size() && !data.empty(); ++sub) {
      const std::size_t size = (entries[sub].bits + 7u) / 8;
      if (size == 0) return abort_code::unsupported;  // a text has no place of its own
      if (data.size() < size) return abort_code::too_short;
      if (entries[sub].writable()) abort = write_sub(index, sub, data.first(size));
      data = data.subspan(size);
    }
    if (abort == 0 && !data.empty()) return abort_code::wrong_length;
    return abort == 0 && counted ? write_sub(index, 0, total) : abort;
  }

  Drive& drive_;
};

}  // namespace fieldbus
