// An EtherCAT frame: Ethernet header, EtherCAT header, and a chain of datagrams, each with a
// command, an address, data and a working counter (ETG.1000.4, section 5.3). Integers are
// little-endian.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>

#include "../little_endian.hpp"

namespace ethercat {

using fieldbus::get16, fieldbus::get32, fieldbus::get64;
using fieldbus::put16, fieldbus::put32, fieldbus::put64;

// Commands of a datagram: 0 NOP; 1 to 12 reading (RD), writing (WR) and both (RW), each by position
// (A), configured station (F), of all (B), by logical address (L); ARMW and FRMW read one slave and
// write to all others.
constexpr std::uint8_t kArmw = 13, kFrmw = 14, kCommands = 15;

// A view of one datagram within its frame.
class Datagram {
 public:
  static constexpr std::size_t kHeader = 10, kCounter = 2;

  explicit Datagram(std::uint8_t* first) : at_(first) {}

  bool known() const { return at_[0] < kCommands; }
  std::uint8_t command() const { return at_[0]; }
  std::uint16_t position() const { return get16(at_ + 2); }
  void set_position(std::uint16_t value) { put16(at_ + 2, value); }
  std::uint16_t offset() const { return get16(at_ + 4); }
  std::uint32_t logical() const { return get32(at_ + 2); }
  std::size_t size() const { return get16(at_ + 6) & 0x07ffu; }
  bool circulating() const { return get16(at_ + 6) & 0x4000u; }
  bool more() const { return get16(at_ + 6) & 0x8000u; }
  void add_interrupts(std::uint16_t events) {
    put16(at_ + 8, static_cast<std::uint16_t>(get16(at_ + 8) | events));
  }
  std::span<std::uint8_t> data() const { return {at_ + kHeader, size()}; }
  std::uint16_t counter() const { return get16(at_ + kHeader + size()); }
  void count(unsigned more) {
    put16(at_ + kHeader + size(), static_cast<std::uint16_t>(counter() + more));
  }
  std::size_t length() const { return kHeader + size() + kCounter; }

 private:
  std::uint8_t* at_;
};

constexpr std::size_t kEthernetHeader = 14, kFrameHeader = 2;
constexpr std::size_t kLongestFrame = 1518;  // with a VLAN tag, without the check sequence

enum class FrameCheck { sound, foreign, malformed, circulating };

// The datagrams of a valid frame: `next` returns one after the other.
class Datagrams {
 public:
  explicit Datagrams(std::span<std::uint8_t> frame)
      : at_(frame.data() + kEthernetHeader + kFrameHeader) {}

  bool left() const { return at_; }
  Datagram next() {
    const Datagram datagram(at_);
    at_ = datagram.more() ? at_ + datagram.length() : nullptr;
    return datagram;
  }

 private:
  std::uint8_t* at_;
};

// Whether every datagram lies within the frame. No part of a frame is executed before this check.
// Slaves apply written data only if the frame's check sequence is right at its end.
inline FrameCheck check(std::span<std::uint8_t> frame) {
  if (frame.size() < kEthernetHeader) return FrameCheck::malformed;
  if (frame[12] != 0x88 || frame[13] != 0xa4) return FrameCheck::foreign;
  if (frame.size() > kLongestFrame) return FrameCheck::malformed;
  if (frame.size() < kEthernetHeader + kFrameHeader) return FrameCheck::malformed;
  const std::uint16_t header = get16(frame.data() + kEthernetHeader);
  const std::size_t length = header & 0x07ffu;
  if (header >> 12 != 1) return FrameCheck::foreign;  // network variables, mailbox gateway
  if (kEthernetHeader + kFrameHeader + length > frame.size()) return FrameCheck::malformed;
  std::size_t used = 0;
  for (bool more = true; more;) {
    if (used + Datagram::kHeader + Datagram::kCounter > length) return FrameCheck::malformed;
    const Datagram datagram(frame.data() + kEthernetHeader + kFrameHeader + used);
    used += datagram.length();
    if (used > length) return FrameCheck::malformed;
    // It has passed the segment already, without reaching the master.
    if (datagram.circulating()) return FrameCheck::circulating;
    more = datagram.more();
  }
  return FrameCheck::sound;
}

}  // namespace ethercat
