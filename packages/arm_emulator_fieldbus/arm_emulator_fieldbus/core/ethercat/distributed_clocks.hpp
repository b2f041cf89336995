// Distributed clocks: each slave has a clock of its own, which a master measures, sets and steers
// after the clock of the first slave (ETG.1000.4, section 6.8; registers from 0x0900 on). Frames
// are delayed from slave to slave; masters compute the delays from the times at which a frame
// passed on its way there and back.
#pragma once

#include <algorithm>

#include "registers.hpp"

namespace ethercat {

// Times at which a frame passes a slave of the segment [ns].
struct Passage {
  std::int64_t there = 0, back = 0;  // in time of the segment
  bool last = true;                  // nothing is connected behind it
};

class DistributedClock {
 public:
  static constexpr std::int64_t kHop = 500;  // ns from one slave to the next
  static constexpr std::size_t kReceived = 0x0900, kSystemTime = 0x0910, kUnitReceived = 0x0918,
                               kOffset = 0x0920, kDelay = 0x0928, kDifference = 0x092c,
                               kSpeedStart = 0x0930, kActivation = 0x0981, kFirstPending = 0x0984,
                               kStart = 0x0990, kCycle = 0x09a0;

  // `ahead`: what this clock shows when the segment's time is 0 [ns], as if it were switched on
  // earlier.
  DistributedClock(Memory& memory, std::int64_t ahead) : memory_(memory) { begin(ahead); }

  // As after switching on.
  void begin(std::int64_t shown) {
    ahead_ = shown;
    start_ = 0;
    memory_.put16(kSpeedStart, 0x1000);
    memory_.put16(0x0934, 0x0c04);  // depths of the filters
    memory_.put16(0x0982, 1000);    // length of a pulse, 10 ns
  }

  // A frame passes.
  void pass(const Passage& now) { passage_ = now; }

  // Puts the time into the registers that a master is about to read.
  void prepare_read(std::size_t address, std::size_t size) {
    if (!is_overlapping(address, size, kSystemTime, 0x09b0 - kSystemTime)) return;
    const std::uint64_t now = system_time();
    memory_.put64(kSystemTime, now);
    const bool pending = sync0() && static_cast<std::int64_t>(start_ - now) > 0;
    memory_.put8(kFirstPending, pending ? 1 : 0);
    if (sync0() && is_overlapping(address, size, kStart, 8))
      memory_.put64(kStart, find_next_pulse(now));
  }

  void handle_write(std::size_t address, std::size_t size) {
    if (is_overlapping(address, size, kReceived, 4)) latch_time();
    if (is_overlapping(address, size, kSystemTime, 4)) adjust_clock(size);
    if (is_overlapping(address, size, kStart, 8)) start_ = memory_.get64(kStart);
    if (is_overlapping(address, size, kSpeedStart, 2)) memory_.put32(kDifference, 0);
  }

  // Read-only registers of the block, and those that a running pulse generator locks.
  bool is_locked(std::size_t address) const {
    return (address >= 0x0904 && address < kSystemTime) ||
           (address >= kUnitReceived && address < kOffset) ||
           (address >= kDifference && address < kSpeedStart) ||
           (address >= kStart && address < kStart + 8 && memory_.get8(kActivation) & 1);
  }

  // Whether a write concerns what SYNC0 does.
  static bool is_pulse_setting(std::size_t address, std::size_t size) {
    return is_overlapping(address, size, kActivation, 1) ||
           is_overlapping(address, size, kCycle, 4);
  }
  bool sync0() const { return (memory_.get8(kActivation) & 3) == 3; }
  std::uint32_t sync0_cycle() const { return memory_.get32(kCycle); }  // ns

 private:
  std::uint64_t local(std::int64_t time) const { return static_cast<std::uint64_t>(time + ahead_); }
  std::uint64_t system_time() const { return local(passage_.there) + memory_.get64(kOffset); }

  void latch_time() {
    memory_.put32(kReceived, static_cast<std::uint32_t>(local(passage_.there)));
    const std::int64_t back = passage_.last ? 0 : passage_.back;
    memory_.put32(kReceived + 4, back ? static_cast<std::uint32_t>(local(back)) : 0);
    memory_.put64(kReceived + 8, 0);  // no such ports
    memory_.put64(kUnitReceived, local(passage_.there));
  }

  // The reference clock's time has arrived: adjust the clock at once, by at most this much.
  void adjust_clock(std::size_t size) {
    constexpr std::int64_t kMaxStep = 1000;  // ns
    const std::uint64_t here = system_time();
    std::uint64_t reference = memory_.get64(kSystemTime) + memory_.get32(kDelay);
    if (size < 8) reference = (here & ~0xffffffffull) | (reference & 0xffffffffull);
    auto difference = static_cast<std::int64_t>(here - reference);
    if (size < 8) difference = static_cast<std::int32_t>(difference);
    const std::uint64_t much =
        static_cast<std::uint64_t>(difference < 0 ? -difference : difference);
    const auto magnitude = static_cast<std::uint32_t>(std::min<std::uint64_t>(much, 0x7fffffff));
    memory_.put32(kDifference, magnitude | (difference < 0 ? 0x80000000u : 0));
    ahead_ -= std::clamp(difference, -kMaxStep, kMaxStep);
  }

  std::uint64_t find_next_pulse(std::uint64_t now) const {
    const std::uint32_t cycle = sync0_cycle();
    const auto since = static_cast<std::int64_t>(now - start_);
    if (since < 0 || cycle == 0) return start_;
    return start_ + (static_cast<std::uint64_t>(since) / cycle + 1) * cycle;
  }

  Memory& memory_;
  std::int64_t ahead_ = 0;
  Passage passage_;
  std::uint64_t start_ = 0;
};

}  // namespace ethercat
