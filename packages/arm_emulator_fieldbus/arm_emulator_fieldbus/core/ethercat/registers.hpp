// The memory of a slave controller (ESC): registers at 0x0000, process RAM from 0x1000 on, and what
// of the registers a master may write (ETG.1000.4, section 6; names as there).
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>

#include "frame.hpp"

namespace ethercat {

namespace reg {
constexpr std::uint16_t kType = 0x0000, kFmmus = 0x0004, kSyncManagers = 0x0005, kRam = 0x0006,
                        kPorts = 0x0007, kFeatures = 0x0008, kStation = 0x0010, kAlias = 0x0012,
                        kReset = 0x0040, kDlControl = 0x0100, kDlStatus = 0x0110,
                        kAlControl = 0x0120, kAlStatus = 0x0130, kAlCode = 0x0134, kPdi = 0x0140,
                        kEventMask = 0x0200, kEvents = 0x0210, kErrors = 0x0300,
                        kUnitErrors = 0x030c, kErrorsEnd = 0x0314, kWatchdogDivider = 0x0400,
                        kWatchdogTime = 0x0420, kWatchdogStatus = 0x0440, kWatchdogCount = 0x0442,
                        kEeprom = 0x0500, kFmmu = 0x0600, kSyncManager = 0x0800, kDc = 0x0900;
}  // namespace reg

// Bits of the event register at 0x0210, which a master finds in each datagram, masked.
namespace event {
constexpr std::uint16_t kAlStatus = 0x0008, kSyncManager0 = 0x0010;
}

constexpr int kFmmus = 8, kSyncManagers = 8;
constexpr std::size_t kRamBegin = 0x1000, kMemory = 0x3000;

class Memory {
 public:
  std::uint8_t* at(std::size_t address) { return bytes_.data() + address; }
  const std::uint8_t* at(std::size_t address) const { return bytes_.data() + address; }
  std::uint8_t get8(std::size_t address) const { return bytes_[address]; }
  std::uint16_t get16(std::size_t address) const { return ethercat::get16(at(address)); }
  std::uint32_t get32(std::size_t address) const { return ethercat::get32(at(address)); }
  std::uint64_t get64(std::size_t address) const { return ethercat::get64(at(address)); }
  void put8(std::size_t address, std::uint8_t value) { bytes_[address] = value; }
  void put16(std::size_t address, std::uint16_t v) { ethercat::put16(at(address), v); }
  void put32(std::size_t address, std::uint32_t v) { ethercat::put32(at(address), v); }
  void put64(std::size_t address, std::uint64_t v) { ethercat::put64(at(address), v); }
  void fill(std::size_t address, std::size_t size) {
    std::fill_n(bytes_.begin() + static_cast<std::ptrdiff_t>(address), size, std::uint8_t{0});
  }

 private:
  std::array<std::uint8_t, kMemory> bytes_ = {};
};

struct Range {
  std::uint16_t begin, end;  // the end is not part of it
};

// Registers that a master may write. Sync managers and clocks make exceptions of their own.
constexpr Range kWritable[] = {
    {0x0010, 0x0012}, {0x0020, 0x0022}, {0x0030, 0x0032},    {0x0040, 0x0042}, {0x0100, 0x0104},
    {0x0108, 0x010a}, {0x0120, 0x0122}, {0x0138, 0x013a},    {0x0200, 0x0208}, {0x0300, 0x0314},
    {0x0400, 0x0402}, {0x0410, 0x0412}, {0x0420, 0x0422},    {0x0442, 0x0444}, {0x0500, 0x0502},
    {0x0502, 0x0510}, {0x0600, 0x0680}, {0x0800, 0x0840},    {0x0900, 0x0938}, {0x0980, 0x0984},
    {0x0990, 0x09ac}, {0x0f80, 0x1000}, {kRamBegin, kMemory}};

constexpr auto kWritableBytes = [] {
  std::array<bool, kMemory> out = {};
  for (const Range range : kWritable)
    for (std::size_t at = range.begin; at < range.end; ++at) out[at] = true;
  return out;
}();

inline bool is_overlapping(std::size_t address, std::size_t size, std::size_t begin,
                           std::size_t length) {
  return address < begin + length && begin < address + size;
}

}  // namespace ethercat
