// A line of slaves: a frame goes through all of them, and comes back from the last.
#pragma once

#include <memory>
#include <vector>

#include "../drives.hpp"
#include "ethercat.h"
#include "slave.hpp"

namespace ethercat {

class Segment {
 public:
  explicit Segment(const ethercat_options& options) : arm_(options) {
    for (int k = 0; k < arm_.all->count(); ++k)
      slaves_.push_back(std::make_unique<Slave>(arm_.all->at(k), k, arm_.period));
  }

  // Passes a frame, in place, at the time `now` [ns]; returns its length on return, 0: lost. Clocks
  // and watchdogs of slaves use logical time in lock-step.
  std::size_t pass(std::span<std::uint8_t> frame, std::int64_t now) {
    const std::int64_t time = arm_.lockstep ? logical_ : now;
    switch (check(frame)) {
      case FrameCheck::foreign:
        ++figures_.foreign;
        return 0;
      case FrameCheck::circulating:
        ++figures_.circulating;
        return 0;
      case FrameCheck::malformed:
        ++figures_.malformed;
        slaves_[0]->count_error();
        return 0;
      case FrameCheck::sound:
        break;
    }
    ++figures_.frames;
    std::size_t reached = 0;  // slaves that the frame passes
    Slave::Onward onward = Slave::Onward::next;
    for (const auto& slave : slaves_) {
      slave->pass({}, ++reached < slaves_.size(), time);
      onward = slave->onward();
      if (onward != Slave::Onward::next) break;
    }
    for (std::size_t k = 0; k < reached; ++k) {
      const auto hops = [](std::size_t count) {
        return DistributedClock::kHop * static_cast<std::int64_t>(count);
      };
      const Passage passage = {time + hops(k), time + hops(2 * (reached - 1) - k),
                               k + 1 == reached};
      slaves_[k]->pass(passage, k + 1 < slaves_.size(), time);
    }
    for (Datagrams datagrams(frame); datagrams.left();) {
      Datagram datagram = datagrams.next();
      if (!datagram.known()) ++figures_.unknown;
      for (std::size_t k = 0; k < reached; ++k) visit(*slaves_[k], datagram);
    }
    if (onward == Slave::Onward::lost) return 0;
    frame[6] |= 2;  // it has been processed, as the first slave reports in the sender's address
    return frame.size();
  }

  // In lock-step: advances by a servo period if a frame has completed an exchange with all drives.
  void finish_exchange() {
    if (!arm_.lockstep || !exchanged()) return;
    ++figures_.exchanges;
    for (std::int64_t k = periods_per_exchange(); k > 0 && !figures_.diverged; --k) {
      logical_ += arm_.period;
      step(logical_);
    }
  }
  // Advances by a servo period, by the clock, at the time `now` [ns].
  int period(std::int64_t now) {
    bool operational = false;
    for (const auto& slave : slaves_) operational = operational || slave->operational();
    if (exchanged())
      ++figures_.exchanges;
    else if (operational)
      ++figures_.lost_cycles;
    logical_ += arm_.period;
    return step(arm_.lockstep ? logical_ : now);
  }
  // Whether process data are exchanged, or were before an error.
  bool exchanges() const {
    for (const auto& slave : slaves_)
      if (slave->exchanges()) return true;
    return false;
  }
  // Servo periods that the host was too late for.
  void count_late(std::int64_t periods) { figures_.late_periods += periods; }

  ethercat_figures figures() const {
    ethercat_figures out = figures_;
    for (const auto& slave : slaves_) {
      out.watchdogs += slave->expired();
      out.operational += slave->operational();
    }
    return out;
  }
  const Slave& slave(std::size_t k) const { return *slaves_[k]; }
  std::int32_t count() const { return static_cast<std::int32_t>(slaves_.size()); }
  bool lockstep() const { return arm_.lockstep; }
  bool diverged() const { return figures_.diverged; }
  std::int64_t period_ns() const { return arm_.period; }

 private:
  // Whether all drives that exchange process data have done so since the last servo period.
  bool exchanged() const {
    bool any = false;
    for (const auto& slave : slaves_) {
      if (!slave->exchanges()) continue;
      if (!slave->exchanged()) return false;
      any = true;
    }
    return any;
  }
  // Servo periods that an exchange stands for: SYNC0's cycle, the shortest of those that the master
  // has set.
  std::int64_t periods_per_exchange() const {
    std::int64_t shortest = 0;
    for (const auto& slave : slaves_) {
      const DistributedClock& clock = slave->distributed_clock();
      if (!slave->exchanges() || !clock.sync0()) continue;
      const std::int64_t its = clock.sync0_cycle() / arm_.period;
      shortest = shortest == 0 ? its : std::min(shortest, its);
    }
    return shortest == 0 ? 1 : shortest;
  }
  // A diverged machine keeps its state.
  int step(std::int64_t time) {
    for (const auto& slave : slaves_) slave->begin_period(time);
    const int result = drives_period(arm_.all);
    figures_.diverged = result != ARM_OK;
    ++figures_.periods;
    for (const auto& slave : slaves_) slave->finish_period();
    return result;
  }

  static void visit(Slave& slave, Datagram& datagram) {
    datagram.add_interrupts(slave.events());
    const int command = datagram.command();
    if (command == 0 || !datagram.known()) return;
    enum Address { kPosition, kStation, kAll, kLogical };
    const bool is_multiple = command == kArmw || command == kFrmw;
    const int address = is_multiple ? command - kArmw : (command - 1) / 3;
    const bool reads = is_multiple || (command - 1) % 3 != 1;
    const bool writes = is_multiple || (command - 1) % 3 != 0;
    if (address == kLogical)
      return datagram.count(slave.logical(datagram.logical(), datagram.data(), reads, writes));
    const bool ours =
        address == kAll ||
        (address == kStation ? slave.has_address(datagram.position()) : datagram.position() == 0);
    if (address != kStation)
      datagram.set_position(static_cast<std::uint16_t>(datagram.position() + 1));
    if (is_multiple)
      exchange_data(slave, datagram, ours, !ours, false);
    else if (ours)
      exchange_data(slave, datagram, reads, writes, address == kAll);
  }
  // Write the datagram's data, and return the data read before, added to them if `add`.
  static void exchange_data(Slave& slave, Datagram& datagram, bool reads, bool writes, bool add) {
    std::array<std::uint8_t, 2048> in;
    const auto data = datagram.data();
    std::copy(data.begin(), data.end(), in.begin());
    const bool was_read = reads && slave.read(datagram.offset(), data, add);
    const bool was_written =
        writes && slave.write(datagram.offset(), std::span(in).first(data.size()));
    datagram.count((was_read ? 1u : 0) + (was_written ? (reads ? 2u : 1u) : 0));
  }

  const ethercat_options arm_;
  std::vector<std::unique_ptr<Slave>> slaves_;
  ethercat_figures figures_ = {};
  std::int64_t logical_ = 0;  // ns
};

}  // namespace ethercat
