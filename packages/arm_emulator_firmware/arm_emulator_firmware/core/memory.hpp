// Flash and RAM of the microcontroller: host memory that the processor works in directly.
#pragma once

#include <cstdint>
#include <cstring>
#include <memory>
#include <vector>

#include "remembered.hpp"

namespace mcu {

class Memory {
 public:
  struct Region {
    uint32_t at, size;
    bool writable, code;
    std::unique_ptr<uint8_t[]> bytes;
  };

  void add(uint32_t at, uint32_t size, bool writable, bool code) {
    regions_.push_back({at, size, writable, code, std::make_unique<uint8_t[]>(size)});
  }

  const std::vector<Region>& regions() const { return regions_; }

  // The region of an address, or null.
  const Region* find_region(uint32_t at) const {
    for (const Region& region : regions_)
      if (at - region.at < region.size) return &region;
    return nullptr;
  }

  // Pointer to a range of bytes; null if it is not within one region.
  uint8_t* find(uint32_t at, uint64_t size) const {
    for (const Region& region : regions_)
      if (at >= region.at && at - region.at + size <= region.size)
        return region.bytes.get() + (at - region.at);
    return nullptr;
  }

  bool read(uint32_t at, void* out, uint64_t size) const {
    const uint8_t* from = find(at, size);
    if (from) std::memcpy(out, from, size);
    return from;
  }

  bool write(uint32_t at, const void* bytes, uint64_t size) {
    uint8_t* to = find(at, size);
    if (to) std::memcpy(to, bytes, size);
    return to;
  }

  // Flash is not among it: nothing but a debugger writes there. Return whether code is another than
  // before.
  bool visit_state(Checkpoint& list) {
    bool other_code = false;
    for (Region& region : regions_) {
      if (!region.writable) continue;
      if (region.code && list.reads())
        other_code |= std::memcmp(region.bytes.get(), list.next(), region.size) != 0;
      list.bytes(region.bytes.get(), region.size);
    }
    return other_code;
  }

 private:
  std::vector<Region> regions_;
};

}  // namespace mcu
