// Fieldbus memory management unit: lays bits of a slave's memory into the logical address space of
// the whole segment (ETG.1000.4, section 6.6; 16 bytes each from register 0x0600 on).
#pragma once

#include <algorithm>

#include "registers.hpp"

namespace ethercat {

// Common part of a logical datagram and a slave's memory, in bits.
struct Mapped {
  std::size_t in_datagram;
  std::size_t address;  // of the slave
  std::size_t size;
};

class Fmmu {
 public:
  explicit Fmmu(const std::uint8_t* at)
      : logical_(get32(at)),
        length_(get16(at + 4)),
        first_bit_(at[6] & 7),
        last_bit_(at[7] & 7),
        physical_(get16(at + 8)),
        physical_bit_(at[10] & 7),
        type_(at[11]),
        active_(at[12] & 1) {}

  bool reads() const { return active_ && length_ > 0 && type_ & 1; }
  bool writes() const { return active_ && length_ > 0 && type_ & 2; }

  // The share of a datagram at `address` with `size` bytes; size 0: no share.
  Mapped find_overlap(std::uint32_t address, std::size_t size) const {
    const std::uint64_t first = std::uint64_t{logical_} * 8 + first_bit_;
    const std::uint64_t last = (std::uint64_t{logical_} + length_ - 1) * 8 + last_bit_;
    const std::uint64_t begin = std::max(first, std::uint64_t{address} * 8);
    const std::uint64_t end = std::min(last + 1, (std::uint64_t{address} + size) * 8);
    if (begin >= end) return {0, 0, 0};
    return {static_cast<std::size_t>(begin - std::uint64_t{address} * 8),
            static_cast<std::size_t>(std::uint64_t{physical_} * 8 + physical_bit_ + begin - first),
            static_cast<std::size_t>(end - begin)};
  }

 private:
  std::uint32_t logical_;
  std::uint16_t length_;
  unsigned first_bit_, last_bit_;
  std::uint16_t physical_;
  unsigned physical_bit_;
  std::uint8_t type_;
  bool active_;
};

inline void copy_bits(const std::uint8_t* from, std::size_t first, std::uint8_t* to, std::size_t at,
                      std::size_t count) {
  if (first % 8 == 0 && at % 8 == 0 && count % 8 == 0) {
    std::copy_n(from + first / 8, count / 8, to + at / 8);
    return;
  }
  for (std::size_t k = 0; k < count; ++k, ++first, ++at) {
    const unsigned bit = (from[first / 8] >> (first % 8)) & 1u;
    to[at / 8] = static_cast<std::uint8_t>((to[at / 8] & ~(1u << (at % 8))) | bit << (at % 8));
  }
}

}  // namespace ethercat
