// The watchdog of the process data (ETG.1000.4, section 6.3; registers 0x0400 to 0x0443): outputs
// must come often enough. The watchdog of the drive's side never runs out, since drive and slave
// are one program.
#pragma once

#include "registers.hpp"

namespace ethercat {

class Watchdog {
 public:
  explicit Watchdog(Memory& memory) : memory_(memory) { begin(); }

  // As after switching on.
  void begin() {
    memory_.put16(reg::kWatchdogDivider, 0x09c2);  // 100 us
    memory_.put16(0x0410, 1000);                   // 100 ms
    memory_.put16(reg::kWatchdogTime, 1000);       // 100 ms
    memory_.put16(reg::kWatchdogStatus, 1);
  }

  void trigger(std::int64_t now) {
    newest_ = now;
    memory_.put16(reg::kWatchdogStatus, 1);
  }
  // Whether it has just run out.
  bool has_expired(std::int64_t now) {
    if (!(memory_.get16(reg::kWatchdogStatus) & 1) || limit() == 0 || now - newest_ <= limit())
      return false;
    memory_.put16(reg::kWatchdogStatus, 0);
    const std::uint8_t count = memory_.get8(reg::kWatchdogCount);
    memory_.put8(reg::kWatchdogCount, static_cast<std::uint8_t>(count + (count < 0xff)));
    return true;
  }

 private:
  std::int64_t limit() const {  // ns
    return (memory_.get16(reg::kWatchdogDivider) + 2) * std::int64_t{40} *
           memory_.get16(reg::kWatchdogTime);
  }

  Memory& memory_;
  std::int64_t newest_ = 0;
};

}  // namespace ethercat
