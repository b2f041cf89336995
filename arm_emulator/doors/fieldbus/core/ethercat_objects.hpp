// The object dictionary for a master on EtherCAT: its entries, and the values of one drive.
#pragma once

#include <algorithm>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "drives.h"
#include "object_dictionary.hpp"

namespace ethercat {

namespace abort_code = fieldbus::abort_code;

class Objects {
 public:
  Objects() {
    drives_entry one = {};
    for (std::int32_t slot = 0; drives_list(slot, &one); ++slot) {
      if (!(one.buses & DRIVES_ETHERCAT)) continue;
      entries_.push_back(one);
      if (one.sub == 0) indices_.push_back(one.index);
    }
  }

  const std::vector<std::uint16_t>& all() const { return indices_; }
  // The entries of an object, none if there is no such object.
  std::span<const drives_entry> object(std::uint16_t index) const {
    const auto [first, last] = std::equal_range(entries_.begin(), entries_.end(), index, ByIndex{});
    return {first, last};
  }
  const drives_entry* entry(std::uint16_t index, std::uint8_t sub) const {
    const auto subs = object(index);
    return sub < subs.size() ? &subs[sub] : nullptr;
  }

 private:
  struct ByIndex {
    bool operator()(const drives_entry& a, std::uint16_t b) const { return a.index < b; }
    bool operator()(std::uint16_t a, const drives_entry& b) const { return a < b.index; }
  };

  std::vector<drives_entry> entries_;
  std::vector<std::uint16_t> indices_;
};

inline bool writable(const drives_entry& entry) { return entry.access >= 2; }

// The values of one drive.
class Door {
 public:
  Door(drives* all, std::int32_t drive) : all_(all), drive_(drive) {}

  // An abort code, 0 for none. `size` gets the number of bytes.
  std::uint32_t read(std::uint16_t index, std::uint8_t sub, std::span<std::uint8_t> out,
                     std::uint32_t& size) const {
    size = 0;
    return drives_read(all_, drive_, index, sub, out.data(), static_cast<std::uint32_t>(out.size()),
                       &size);
  }
  std::uint32_t write(std::uint16_t index, std::uint8_t sub,
                      std::span<const std::uint8_t> in) const {
    return drives_write(all_, drive_, index, sub, in.data(), static_cast<std::uint32_t>(in.size()));
  }
  // The value of a number; 0 without one.
  std::uint32_t number(std::uint16_t index, std::uint8_t sub) const {
    std::uint8_t bytes[8] = {};
    std::uint32_t size = 0;
    if (read(index, sub, bytes, size) != 0 || size > 4) return 0;
    return static_cast<std::uint32_t>(bytes[0] | bytes[1] << 8 | bytes[2] << 16) |
           static_cast<std::uint32_t>(bytes[3]) << 24;
  }
  std::string text(std::uint16_t index) const {
    std::uint8_t bytes[256] = {};
    std::uint32_t size = 0;
    if (read(index, 0, bytes, size) != 0 || size > sizeof bytes) return {};
    return {bytes, bytes + size};
  }

 private:
  drives* all_;
  std::int32_t drive_;
};

}  // namespace ethercat
