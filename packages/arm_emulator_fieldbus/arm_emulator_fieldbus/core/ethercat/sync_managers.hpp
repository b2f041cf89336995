// Sync managers guard areas of a slave's memory, so that master and drive exchange them whole
// (ETG.1000.4, section 6.7; 8 bytes each from register 0x0800 on). A mailbox holds one message
// until the other side has taken it; a buffer of process data always holds the newest.
#pragma once

#include "registers.hpp"

namespace ethercat {

class SyncManagers {
 public:
  explicit SyncManagers(Memory& memory) : memory_(memory) {}

  // Each side has a switch: the master switches an area on, the slave serves it in the states that
  // need it. An area that is on and not served is closed: it counts in no working counter.
  bool is_switched_on(int k) const { return memory_.get8(at(k) + 6) & 1; }
  bool is_served(int k) const { return !(memory_.get8(at(k) + 7) & 1); }
  bool is_enabled(int k) const { return is_switched_on(k) && is_served(k); }
  void serve(int k, bool on) {
    if (on == is_served(k)) return;
    const std::uint8_t rest = memory_.get8(at(k) + 7) & 0xfe;
    memory_.put8(at(k) + 7, static_cast<std::uint8_t>(rest | (on ? 0 : 1)));
    if (!on) clear_area(k);
  }
  bool is_mailbox(int k) const { return (memory_.get8(at(k) + 4) & 3) == 2; }
  bool is_written_by_master(int k) const { return (memory_.get8(at(k) + 4) & 0x0c) == 4; }
  bool is_watchdog_trigger(int k) const { return memory_.get8(at(k) + 4) & 0x40; }
  bool is_repeat_requested(int k) const { return memory_.get8(at(k) + 6) & 2; }
  void acknowledge_repeat(int k) {
    const std::uint8_t rest = memory_.get8(at(k) + 7) & 0xfd;
    memory_.put8(at(k) + 7, static_cast<std::uint8_t>(rest | (is_repeat_requested(k) ? 2 : 0)));
  }
  std::size_t start(int k) const { return memory_.get16(at(k)); }
  std::size_t length(int k) const { return memory_.get16(at(k) + 2); }
  std::uint8_t* area(int k) { return memory_.at(start(k)); }

  bool is_full(int k) const { return memory_.get8(at(k) + 5) & 0x08; }
  void set_full(int k, bool full) {
    const std::uint8_t rest = memory_.get8(at(k) + 5) & 0xf7;
    memory_.put8(at(k) + 5, static_cast<std::uint8_t>(rest | (full ? 0x08 : 0)));
    if (!full) opened_[k] = false;
  }
  // The next of the three buffers holds the newest data.
  void turn_buffer(int k) {
    const std::uint8_t status = memory_.get8(at(k) + 5);
    const unsigned buffer = (((status >> 4) & 3u) + 1) % 3;
    memory_.put8(at(k) + 5, static_cast<std::uint8_t>((status & 0xcf) | buffer << 4));
  }

  // Whether the master may read (write) these bytes now. A mailbox and a buffer are opened with
  // their first byte.
  bool can_access(std::size_t address, std::size_t size, bool write) {
    for (int k = 0; k < kSyncManagers; ++k) {
      if (!is_switched_on(k) || !is_overlapping(address, size, start(k), length(k))) continue;
      if (!is_served(k)) return false;
      if (is_written_by_master(k) != write) return false;
      if (is_mailbox(k) && is_full(k) == write) return false;
      if (address <= start(k)) opened_[k] = true;
      if (!opened_[k]) return false;
    }
    return true;
  }

  // Calls done(k) for each enabled area whose last byte was part of an access that was permitted.
  template <class Done>
  void close(std::size_t address, std::size_t size, Done done) {
    for (int k = 0; k < kSyncManagers; ++k) {
      const std::size_t last = start(k) + length(k) - 1;
      if (!is_enabled(k) || length(k) == 0 || last < address || last >= address + size) continue;
      opened_[k] = false;
      done(k);
    }
  }

  // The master has written to these registers: an area that is switched on begins empty.
  void configure(std::size_t address, std::size_t size) {
    for (int k = 0; k < kSyncManagers; ++k)
      if (is_overlapping(address, size, at(k), 8) && !is_switched_on(k)) clear_area(k);
  }

  // Whether a master cannot change this byte of the registers now: status, the slave's own bytes,
  // and the area of an active sync manager.
  bool is_locked(std::size_t address) const {
    const std::size_t byte = (address - reg::kSyncManager) % 8;
    const int k = static_cast<int>((address - reg::kSyncManager) / 8);
    return byte == 5 || byte == 7 || (byte < 5 && is_switched_on(k));
  }

 private:
  void clear_area(int k) {
    memory_.put8(at(k) + 5, memory_.get8(at(k) + 5) & 0xc0);
    opened_[k] = false;
  }
  static std::size_t at(int k) { return reg::kSyncManager + 8 * static_cast<std::size_t>(k); }

  Memory& memory_;
  std::array<bool, kSyncManagers> opened_ = {};
};

}  // namespace ethercat
