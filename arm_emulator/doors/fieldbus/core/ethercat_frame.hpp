// An EtherCAT frame: Ethernet header, EtherCAT header, and a chain of datagrams, each with a
// command, an address, data and a working counter (ETG.1000.4, section 5.3). Integers are
// little-endian.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>

#include "little_endian.hpp"

namespace ethercat {

using fieldbus::get16, fieldbus::get32, fieldbus::get64;
using fieldbus::put16, fieldbus::put32, fieldbus::put64;

// How a datagram addresses: by position (A), configured station (F), all (B), logically (L).
enum class Command : std::uint8_t {
  NOP,
  APRD,
  APWR,
  APRW,
  FPRD,
  FPWR,
  FPRW,
  BRD,
  BWR,
  BRW,
  LRD,
  LWR,
  LRW,
  ARMW,
  FRMW
};  // clang-format off: as the standard numbers them
// clang-format on
constexpr std::uint8_t kCommands = 15;

// A view of one datagram within its frame.
class Datagram {
 public:
  static constexpr std::size_t kHeader = 10, kCounter = 2;

  explicit Datagram(std::uint8_t* first) : at(first) {}

  bool known() const { return at[0] < kCommands; }
  Command command() const { return static_cast<Command>(at[0]); }
  std::uint16_t position() const { return get16(at + 2); }
  void set_position(std::uint16_t value) { put16(at + 2, value); }
  std::uint16_t offset() const { return get16(at + 4); }
  std::uint32_t logical() const { return get32(at + 2); }
  std::size_t size() const { return get16(at + 6) & 0x07ffu; }
  bool circulating() const { return get16(at + 6) & 0x4000u; }
  bool more() const { return get16(at + 6) & 0x8000u; }
  void add_interrupts(std::uint16_t events) {
    put16(at + 8, static_cast<std::uint16_t>(get16(at + 8) | events));
  }
  std::span<std::uint8_t> data() const { return {at + kHeader, size()}; }
  std::uint16_t counter() const { return get16(at + kHeader + size()); }
  void count(unsigned more) {
    put16(at + kHeader + size(), static_cast<std::uint16_t>(counter() + more));
  }
  std::size_t length() const { return kHeader + size() + kCounter; }

 private:
  std::uint8_t* at;
};

constexpr std::size_t kEthernetHeader = 14, kFrameHeader = 2;
constexpr std::size_t kLongestFrame = 1518;  // with a VLAN tag, without the check sequence

enum class FrameCheck { SOUND, FOREIGN, MALFORMED, CIRCULATING };

// The datagrams of a frame that was found sound: `next` gives one after the other.
class Datagrams {
 public:
  explicit Datagrams(std::span<std::uint8_t> frame)
      : at(frame.data() + kEthernetHeader + kFrameHeader) {}

  bool left() const { return at; }
  Datagram next() {
    const Datagram datagram(at);
    at = datagram.more() ? at + datagram.length() : nullptr;
    return datagram;
  }

 private:
  std::uint8_t* at;
};

// Whether every datagram lies within the frame. Nothing of a frame is carried out before, since
// slaves take over what was written only if the frame's check sequence is right at its end.
inline FrameCheck check(std::span<std::uint8_t> frame) {
  if (frame.size() < kEthernetHeader) return FrameCheck::MALFORMED;
  if (frame[12] != 0x88 || frame[13] != 0xa4) return FrameCheck::FOREIGN;
  if (frame.size() > kLongestFrame) return FrameCheck::MALFORMED;
  if (frame.size() < kEthernetHeader + kFrameHeader) return FrameCheck::MALFORMED;
  const std::uint16_t header = get16(frame.data() + kEthernetHeader);
  const std::size_t length = header & 0x07ffu;
  if (header >> 12 != 1) return FrameCheck::FOREIGN;  // network variables, mailbox gateway
  if (kEthernetHeader + kFrameHeader + length > frame.size()) return FrameCheck::MALFORMED;
  std::size_t used = 0;
  for (bool more = true; more;) {
    if (used + Datagram::kHeader + Datagram::kCounter > length) return FrameCheck::MALFORMED;
    const Datagram datagram(frame.data() + kEthernetHeader + kFrameHeader + used);
    used += datagram.length();
    if (used > length) return FrameCheck::MALFORMED;
    // It has been around the segment already, without having met the master.
    if (datagram.circulating()) return FrameCheck::CIRCULATING;
    more = datagram.more();
  }
  return FrameCheck::SOUND;
}

}  // namespace ethercat
