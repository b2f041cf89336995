// One slave: a slave controller with a drive behind it. Datagrams read and write its memory;
// `handle_read` and `handle_write` react.
#pragma once

#include <algorithm>
#include <string>

#include "al_state.hpp"
#include "distributed_clocks.hpp"
#include "fmmu.hpp"
#include "mailbox.hpp"
#include "process_data.hpp"
#include "sii.hpp"
#include "sync_managers.hpp"
#include "watchdog.hpp"

namespace ethercat {

class Slave {
 public:
  static constexpr int kOutputs = 2, kInputs = 3;  // sync managers
  // Objects of the sync managers, their subs, and synchronization types.
  static constexpr std::uint16_t kOutputParameters = 0x1c32, kInputParameters = 0x1c33;
  static constexpr std::uint8_t kSyncType = 1, kCycleTime = 2, kSync0CycleTime = 10;
  static constexpr std::int64_t kWithOutputs = 1, kWithSync0 = 2, kWithData = 0x22;
  static constexpr std::uint16_t kWatchdogError = 0x821b, kLeftOpError = 0x8100;  // 0x603F

  // `period`: of the servo [ns].
  // `place`: how many slaves are before this one.
  Slave(Drive& drive, int place, std::int64_t period)
      : drive_(drive),
        place_(place),
        period_(period),
        managers_(memory_),
        outputs_(drive, ProcessData::Way::outputs),
        inputs_(drive, ProcessData::Way::inputs),
        sii_(memory_, make_sii_image(drive.values())),
        clock_(memory_, ahead()),
        watchdog_(memory_),
        mailbox_(managers_, drive),
        al_(memory_) {
    describe_controller();
    serve_areas();
    errors_reported_ = error_code();
  }
  Slave(const Slave&) = delete;

  // ----------------------------------------------------------------------------- passing of frames

  // A frame passes; `connected`: another slave is behind this one.
  void pass(const Passage& passage, bool connected, std::int64_t time) {
    clock_.pass(passage);
    now_ = time;
    next_ = connected;
  }
  // Whether a frame continues to the next slave, returns from here, or is lost.
  enum class Onward { next, back, lost };
  Onward onward() const {
    const int port1 = (memory_.get8(reg::kDlControl + 1) >> 2) & 3;
    if (port1 == 3) return Onward::back;
    if (next_) return Onward::next;
    return port1 == 2 ? Onward::lost : Onward::back;
  }
  bool has_address(std::uint16_t station) const {
    const bool alias = memory_.get8(reg::kDlControl + 3) & 1;
    return memory_.get16(reg::kStation) == station ||
           (alias && memory_.get16(reg::kAlias) == station);
  }
  // Events that the master has asked to be reported in each datagram.
  std::uint16_t events() const { return all_events() & memory_.get16(reg::kEventMask); }

  // Read memory into `out`, by bits added to what is there if `add`; whether it was permitted.
  bool read(std::size_t address, std::span<std::uint8_t> out, bool add) {
    if (address >= kMemory || !managers_.can_access(address, out.size(), false)) return false;
    prepare_read(address, out.size());
    const std::size_t size = std::min(out.size(), kMemory - address);
    for (std::size_t k = 0; k < size; ++k) {
      const std::uint8_t byte = memory_.get8(address + k);
      out[k] = add ? static_cast<std::uint8_t>(out[k] | byte) : byte;
    }
    if (!add)
      std::fill(out.begin() + static_cast<std::ptrdiff_t>(size), out.end(), std::uint8_t{0});
    handle_read(address, size);
    return true;
  }
  bool write(std::size_t address, std::span<const std::uint8_t> in) {
    if (address >= kMemory || !managers_.can_access(address, in.size(), true)) return false;
    const std::size_t size = std::min(in.size(), kMemory - address);
    bool any = false;
    std::array<std::uint8_t, 8 * kSyncManagers> guards;
    std::copy_n(memory_.at(reg::kSyncManager), guards.size(), guards.begin());
    for (std::size_t k = 0; k < size; ++k) {
      const std::size_t at = address + k;
      if (!kWritableBytes[at]) continue;
      any = true;
      if (at >= reg::kSyncManager && at < reg::kSyncManager + guards.size()) {
        if (!managers_.is_locked(at)) guards[at - reg::kSyncManager] = in[k];
      } else if (at < reg::kDc || at >= 0x0a00 || !clock_.is_locked(at)) {
        memory_.put8(at, in[k]);
      }
    }
    std::copy(guards.begin(), guards.end(), memory_.at(reg::kSyncManager));
    if (any) handle_write(address, in.first(size));
    return any;
  }

  // The parts of a logical datagram that this slave's units map; how much its counter goes up.
  unsigned logical(std::uint32_t address, std::span<std::uint8_t> data, bool reads, bool writes) {
    unsigned written = 0, read = 0;
    // Outputs are taken from the datagram before inputs are put into it.
    for (int k = 0; writes && k < kFmmus; ++k)
      if (const Fmmu unit = fmmu(k); unit.writes() && take(unit, address, data)) written = 1;
    for (int k = 0; reads && k < kFmmus; ++k)
      if (const Fmmu unit = fmmu(k); unit.reads() && give(unit, address, data)) read = 1;
    return reads && writes ? read + 2 * written : read + written;
  }

  // --------------------------------------------------------------------------------- servo periods

  // Whether it takes part in the exchange of process data.
  bool exchanges() const {
    const bool any = outputs_.size() + inputs_.size() > 0;
    return any && (al_.state() == State::safeop || operational());
  }
  bool operational() const { return al_.state() == State::op; }
  // Whether a frame has brought outputs and taken inputs since the last servo period.
  bool exchanged() const {
    return (outputs_.size() == 0 || written_) && (inputs_.size() == 0 || read_);
  }
  bool written() const { return written_; }
  const DistributedClock& distributed_clock() const { return clock_; }

  void begin_period(std::int64_t time) {
    now_ = time;
    if (al_.state() == State::op && managers_.is_watchdog_trigger(kOutputs) &&
        watchdog_.has_expired(time)) {
      fall_back(State::safeop, AlCode::watchdog);
      drive_.lost(kWatchdogError);
      ++expired_;
    }
    if (al_.state() == State::op && written_) outputs_.write_outputs(managers_.area(kOutputs));
  }
  void finish_period() {
    written_ = read_ = false;
    if (exchanges() && inputs_.size() > 0) {
      inputs_.read_inputs(managers_.area(kInputs));
      managers_.turn_buffer(kInputs);
    }
    const std::uint16_t error = error_code();
    if (error == errors_reported_) return;
    errors_reported_ = error;
    mailbox_.send_emergency(error, static_cast<std::uint8_t>(drive_.values().number(0x1001, 0)));
  }

  // A frame was thrown away.
  void count_error() {
    std::uint8_t& count = *memory_.at(reg::kUnitErrors);
    count = static_cast<std::uint8_t>(count + (count < 0xff));
  }
  std::int64_t expired() const { return expired_; }
  const Memory& contents() const { return memory_; }

 private:
  // Slaves are switched on one after the other [ns].
  std::int64_t ahead() const { return 1'000'000'007LL * (place_ + 1); }

  void describe_controller() {
    memory_.put8(reg::kType, 0x11);
    memory_.put16(reg::kType + 2, 2);
    memory_.put8(reg::kFmmus, ethercat::kFmmus);
    memory_.put8(reg::kSyncManagers, ethercat::kSyncManagers);
    memory_.put8(reg::kRam, (kMemory - kRamBegin) / 1024);
    memory_.put8(reg::kPorts, 0x0f);        // ports 0 and 1: MII
    memory_.put16(reg::kFeatures, 0x018c);  // distributed clocks of 64 bits, bits in FMMUs
    memory_.put32(reg::kDlControl, 1);
  }

  Fmmu fmmu(int k) const { return Fmmu(memory_.at(reg::kFmmu + 16 * static_cast<std::size_t>(k))); }

  // Outputs: bits of a datagram go to the memory. Other bits of a byte are kept.
  bool take(const Fmmu& unit, std::uint32_t address, std::span<const std::uint8_t> data) {
    Shared share;
    if (!find_shared(unit.find_overlap(address, data.size()), share)) return false;
    std::copy_n(memory_.at(share.first), share.size, share.bytes.begin());
    copy_bits(data.data(), share.bits.in_datagram, share.bytes.data(), share.bit, share.bits.size);
    return write(share.first, std::span(share.bytes).first(share.size));
  }
  // Inputs: the other way round.
  bool give(const Fmmu& unit, std::uint32_t address, std::span<std::uint8_t> data) {
    Shared share;
    if (!find_shared(unit.find_overlap(address, data.size()), share)) return false;
    if (!read(share.first, std::span(share.bytes).first(share.size), false)) return false;
    copy_bits(share.bytes.data(), share.bit, data.data(), share.bits.in_datagram, share.bits.size);
    return true;
  }
  // The bytes of the memory, `size` from `first` on, in which the share of a unit in a datagram
  // begins with bit `bit`.
  struct Shared {
    Mapped bits;
    std::size_t first, size, bit;
    std::array<std::uint8_t, 2049> bytes;
  };
  static bool find_shared(const Mapped& bits, Shared& out) {
    out.bits = bits;
    out.first = bits.address / 8;
    out.bit = bits.address % 8;
    out.size = (out.bit + bits.size + 7) / 8;
    return bits.size > 0 && out.first + out.size <= kMemory;
  }

  void prepare_read(std::size_t address, std::size_t size) {
    if (address >= kRamBegin) return;
    clock_.prepare_read(address, size);
    if (is_overlapping(address, size, reg::kDlStatus, 2)) {
      const bool closed = onward() != Onward::next;
      // Ports 2 and 3 do not exist; port 0 leads to the master.
      memory_.put16(reg::kDlStatus, static_cast<std::uint16_t>(0x5217 | (next_ ? 0x20 : 0) |
                                                               (closed ? 0x0400 : 0x0800)));
    }
    if (is_overlapping(address, size, reg::kEvents, 2)) memory_.put16(reg::kEvents, all_events());
  }
  std::uint16_t all_events() const {
    unsigned events = memory_.get16(reg::kEvents) & 0x000fu;
    for (int k = 0; k < ethercat::kSyncManagers; ++k)
      if (managers_.is_full(k)) events |= static_cast<unsigned>(event::kSyncManager0) << k;
    return static_cast<std::uint16_t>(events);
  }
  void handle_read(std::size_t address, std::size_t size) {
    managers_.close(address, size, [this](int k) {
      if (managers_.is_written_by_master(k)) return;
      if (managers_.is_mailbox(k)) {
        if (k == Mailbox::kIn)
          mailbox_.read();
        else
          managers_.set_full(k, false);
      }
      if (k == kInputs) read_ = true;
    });
    if (is_overlapping(address, size, reg::kAlStatus, 2)) {
      const unsigned rest = memory_.get16(reg::kEvents) & ~unsigned{event::kAlStatus};
      memory_.put16(reg::kEvents, static_cast<std::uint16_t>(rest));
    }
  }
  void handle_write(std::size_t address, std::span<const std::uint8_t> in) {
    const std::size_t size = in.size();
    managers_.close(address, size, [this](int k) {
      if (!managers_.is_written_by_master(k)) return;
      if (k == Mailbox::kOut && managers_.is_mailbox(k))
        mailbox_.written();
      else if (managers_.is_mailbox(k))
        managers_.set_full(k, true);
      else
        managers_.turn_buffer(k);
      if (k == kOutputs) take_outputs();
    });
    if (address >= kRamBegin) return;
    if (is_overlapping(address, size, reg::kErrors, reg::kErrorsEnd - reg::kErrors))
      memory_.fill(reg::kErrors, reg::kErrorsEnd - reg::kErrors);  // any write clears them
    if (is_overlapping(address, size, reg::kWatchdogCount, 2))
      memory_.put16(reg::kWatchdogCount, 0);
    sii_.handle_write(address, size);
    if (is_overlapping(address, size, reg::kSyncManager, 8 * ethercat::kSyncManagers)) {
      managers_.configure(address, size);
      mailbox_.handle_write();
      check_guards();
    }
    clock_.handle_write(address, size);
    if (DistributedClock::is_pulse_setting(address, size)) check_pulses();
    if (is_overlapping(address, size, reg::kReset, 1)) handle_reset(in[reg::kReset - address]);
    if (is_overlapping(address, size, reg::kAlControl, 1)) {
      al_.request([this](State to) { return enter(to); });
      serve_areas();
    }
  }

  void take_outputs() {
    written_ = true;
    watchdog_.trigger(now_);
  }

  // ---------------------------------------------------------------------------------------- states

  AlCode enter(State to) {
    const State from = al_.state();
    if (to == State::op) {
      watchdog_.trigger(now_);
      return AlCode::none;
    }
    if (to == State::safeop && from == State::preop) return enter_safeop();
    if (to == State::preop && from == State::init) {
      if (!mailboxes_fit()) return AlCode::mailbox;
      mailbox_.begin();
      return AlCode::none;
    }
    leave(from, to);
    return AlCode::none;
  }
  AlCode enter_safeop() {
    outputs_.compile();
    inputs_.compile();
    if (!is_valid_buffer(kOutputs, area::kOutputs, area::kInputs, outputs_.size(), true))
      return AlCode::outputs;
    if (!is_valid_buffer(kInputs, area::kInputs, 0x1800, inputs_.size(), false))
      return AlCode::inputs;
    if (!pulses_fit()) return AlCode::syn_c0_cycle;
    report_pulses();
    drive_.lock_mapping(true);
    written_ = read_ = false;
    if (inputs_.size() > 0) inputs_.read_inputs(managers_.area(kInputs));
    return AlCode::none;
  }
  // One or more steps down.
  void leave(State from, State to) {
    if (from == State::op) drive_.lost(kLeftOpError);
    if (to == State::safeop) return;
    if (from == State::safeop || from == State::op) drive_.lock_mapping(false);
  }
  // An error takes it down.
  void fall_back(State to, AlCode why) {
    al_.set(to, why);
    serve_areas();
  }
  // Mailboxes are served from PREOP on, process data from SAFEOP on (outputs too, which the drive
  // takes in OP only), and other areas never.
  void serve_areas() {
    const State state = al_.state();
    for (int k = 0; k < ethercat::kSyncManagers; ++k) {
      const bool mail = k == Mailbox::kOut || k == Mailbox::kIn;
      const bool data = k == kOutputs || k == kInputs;
      managers_.serve(k, (mail && state != State::init) ||
                             (data && (state == State::safeop || state == State::op)));
    }
  }

  bool mailboxes_fit() const {
    const auto sound = [this](int k, std::size_t start, bool by_master) {
      return managers_.is_switched_on(k) && managers_.is_mailbox(k) &&
             managers_.is_written_by_master(k) == by_master && managers_.start(k) == start &&
             managers_.length(k) >= 34 && managers_.length(k) <= area::kMailbox;
    };
    return sound(Mailbox::kOut, area::kMailboxOut, true) &&
           sound(Mailbox::kIn, area::kMailboxIn, false);
  }
  // Buffers of process data: three of them lie one after the other.
  bool is_valid_buffer(int k, std::size_t start, std::size_t end, std::size_t size,
                       bool by_master) const {
    if (size == 0) return !managers_.is_switched_on(k) || managers_.length(k) == 0;
    return managers_.is_switched_on(k) && !managers_.is_mailbox(k) &&
           managers_.is_written_by_master(k) == by_master && managers_.start(k) == start &&
           managers_.length(k) == size && start + 3 * size <= end;
  }
  // A master that changes a sync manager in use resets its dependents.
  void check_guards() {
    const State state = al_.state();
    if (state == State::init) return;
    if (!mailboxes_fit()) {
      leave(state, State::init);
      fall_back(State::init, AlCode::mailbox);
      return;
    }
    if (!exchanges()) return;
    const bool out =
        is_valid_buffer(kOutputs, area::kOutputs, area::kInputs, outputs_.size(), true);
    if (out && is_valid_buffer(kInputs, area::kInputs, 0x1800, inputs_.size(), false)) return;
    leave(state, State::preop);
    fall_back(State::preop, out ? AlCode::inputs : AlCode::outputs);
  }

  // An exchange stands for whole servo periods.
  bool pulses_fit() const {
    return !clock_.sync0() || (clock_.sync0_cycle() != 0 && clock_.sync0_cycle() % period_ == 0);
  }
  // The same where a master sets SYNC0 late.
  void check_pulses() {
    if (!exchanges()) return;
    if (pulses_fit()) return report_pulses();
    leave(al_.state(), State::preop);
    fall_back(State::preop, AlCode::syn_c0_cycle);
  }

  // Targets come with SYNC0, if it is on: the drive interpolates over its cycle, and the objects of
  // both sync managers show it (ETG.1020: 2, synchronous with SYNC0, and its cycle).
  void report_pulses() {
    const bool on = clock_.sync0();
    if (!on && !follows_sync0_) return;  // the type and the times are those of the master
    follows_sync0_ = on;
    const std::int64_t cycle = on ? clock_.sync0_cycle() : 0;
    for (const std::uint16_t index : {kOutputParameters, kInputParameters}) {
      const std::int64_t by_data = index == kOutputParameters ? kWithOutputs : kWithData;
      drive_.set(index, kSyncType, on ? kWithSync0 : by_data);
      drive_.set(index, kCycleTime, cycle);
      drive_.set(index, kSync0CycleTime, cycle);
    }
    drive_.set_cycle(cycle);
  }

  // "R", "E", "S" one after the other reset the controller.
  void handle_reset(std::uint8_t letter) {
    static constexpr std::uint8_t kWord[] = {'R', 'E', 'S'};
    reset_letters_ = letter == kWord[reset_letters_] ? reset_letters_ + 1 : letter == 'R' ? 1 : 0;
    if (reset_letters_ < 3) return;
    reset_letters_ = 0;
    leave(al_.state(), State::init);
    memory_ = Memory();
    describe_controller();
    sii_.reload();
    clock_.begin(ahead());
    watchdog_.begin();
    fall_back(State::init, AlCode::none);
  }

  std::uint16_t error_code() const {
    return static_cast<std::uint16_t>(drive_.values().number(0x603f, 0));
  }

  Drive& drive_;
  const int place_;
  const std::int64_t period_;
  Memory memory_;
  SyncManagers managers_;
  ProcessData outputs_, inputs_;
  Sii sii_;
  DistributedClock clock_;
  Watchdog watchdog_;
  Mailbox mailbox_;
  AlState al_;
  std::int64_t now_ = 0;                 // ns, time of the segment
  bool next_ = false;                    // a slave is connected behind this one
  bool follows_sync0_ = false;           // objects of the sync managers show SYNC0
  bool written_ = false, read_ = false;  // since the last servo period
  std::uint16_t errors_reported_ = 0;
  int reset_letters_ = 0;
  std::int64_t expired_ = 0;
};

}  // namespace ethercat
