// One slave: a slave controller with a drive behind it. Datagrams read and write its memory; what
// they set off stands in `after_read` and `after_write`.
#pragma once

#include <algorithm>
#include <string>

#include "ethercat_al_state.hpp"
#include "ethercat_distributed_clocks.hpp"
#include "ethercat_fmmu.hpp"
#include "ethercat_mailbox.hpp"
#include "ethercat_process_data.hpp"
#include "ethercat_sii.hpp"
#include "ethercat_sync_managers.hpp"
#include "ethercat_watchdog.hpp"

namespace ethercat {

class Slave {
 public:
  static constexpr int kOutputs = 2, kInputs = 3;                                 // sync managers
  static constexpr std::uint16_t kWatchdogError = 0x821b, kLeftOpError = 0x8100;  // 0x603F

  // `period`: of the servo [ns].
  Slave(drives* all, const Objects& objects, std::int32_t drive, std::int64_t period)
      : all(all),
        drive(drive),
        period(period),
        door(all, drive),
        managers(memory),
        outputs(objects, door, ProcessData::Way::OUTPUTS),
        inputs(objects, door, ProcessData::Way::INPUTS),
        sii(memory, image()),
        clock(memory, ahead()),
        watchdog(memory),
        mailbox(managers, objects, door),
        al(memory) {
    describe_controller();
    serve_areas();
    errors_told = error_code();
  }
  Slave(const Slave&) = delete;

  // ------------------------------------------------------------------------ where frames come by

  // A frame comes by; `connected`: another slave is behind this one.
  void pass(const Passage& passage, bool connected, std::int64_t time) {
    clock.pass(passage);
    now = time;
    next = connected;
  }
  // Whether a frame goes on to the next slave, comes back from here, or is lost.
  enum class Onward { NEXT, BACK, LOST };
  Onward onward() const {
    const int port1 = (memory.get8(reg::kDlControl + 1) >> 2) & 3;
    if (port1 == 3) return Onward::BACK;
    if (next) return Onward::NEXT;
    return port1 == 2 ? Onward::LOST : Onward::BACK;
  }
  bool has_address(std::uint16_t station) const {
    const bool alias = memory.get8(reg::kDlControl + 3) & 1;
    return memory.get16(reg::kStation) == station ||
           (alias && memory.get16(reg::kAlias) == station);
  }
  // Events that the master has asked to be told in each datagram.
  std::uint16_t events() const { return all_events() & memory.get16(reg::kEventMask); }

  // Read memory into `out`, by bits added to what is there if `add`; whether it was permitted.
  bool read(std::size_t address, std::span<std::uint8_t> out, bool add) {
    if (address >= kMemory || !managers.permits(address, out.size(), false)) return false;
    before_read(address, out.size());
    const std::size_t size = std::min(out.size(), kMemory - address);
    for (std::size_t k = 0; k < size; ++k) {
      const std::uint8_t byte = memory.get8(address + k);
      out[k] = add ? static_cast<std::uint8_t>(out[k] | byte) : byte;
    }
    if (!add)
      std::fill(out.begin() + static_cast<std::ptrdiff_t>(size), out.end(), std::uint8_t{0});
    after_read(address, size);
    return true;
  }
  bool write(std::size_t address, std::span<const std::uint8_t> in) {
    if (address >= kMemory || !managers.permits(address, in.size(), true)) return false;
    const std::size_t size = std::min(in.size(), kMemory - address);
    bool any = false;
    std::array<std::uint8_t, 8 * kSyncManagers> guards;
    std::copy_n(memory.at(reg::kSyncManager), guards.size(), guards.begin());
    for (std::size_t k = 0; k < size; ++k) {
      const std::size_t at = address + k;
      if (!kWritableBytes[at]) continue;
      any = true;
      if (at >= reg::kSyncManager && at < reg::kSyncManager + guards.size()) {
        if (!managers.locked(at)) guards[at - reg::kSyncManager] = in[k];
      } else if (at < reg::kDc || at >= 0x0a00 || !clock.locked(at)) {
        memory.put8(at, in[k]);
      }
    }
    std::copy(guards.begin(), guards.end(), memory.at(reg::kSyncManager));
    if (any) after_write(address, in.first(size));
    return any;
  }

  // The parts of a logical datagram that this slave's units map; how much its counter goes up.
  unsigned logical(std::uint32_t address, std::span<std::uint8_t> data, bool reads, bool writes) {
    unsigned written = 0, read_ = 0;
    // Outputs are taken from the datagram before inputs are put into it.
    for (int k = 0; writes && k < kFmmus; ++k)
      if (const Fmmu unit = fmmu(k); unit.writes() && take(unit, address, data)) written = 1;
    for (int k = 0; reads && k < kFmmus; ++k)
      if (const Fmmu unit = fmmu(k); unit.reads() && give(unit, address, data)) read_ = 1;
    return reads && writes ? read_ + 2 * written : read_ + written;
  }

  // ---------------------------------------------------------------------------- servo periods

  // Whether it takes part in the exchange of process data.
  bool exchanges() const {
    const bool any = outputs.size() + inputs.size() > 0;
    return any && (al.state() == State::SAFEOP || operational());
  }
  bool operational() const { return al.state() == State::OP; }
  // Whether a frame has brought outputs and taken inputs since the last servo period.
  bool exchanged() const {
    return (outputs.size() == 0 || written_) && (inputs.size() == 0 || read_);
  }
  bool written() const { return written_; }
  const DistributedClock& distributed_clock() const { return clock; }

  void before_period(std::int64_t time) {
    now = time;
    if (al.state() == State::OP && managers.triggers_watchdog(kOutputs) && watchdog.expires(time)) {
      fall(State::SAFEOP, AlCode::WATCHDOG);
      drives_lost(all, drive, kWatchdogError);
      ++expired_;
    }
    if (al.state() == State::OP && written_) outputs.to_drive(managers.area(kOutputs));
  }
  void after_period() {
    written_ = read_ = false;
    if (exchanges() && inputs.size() > 0) {
      inputs.from_drive(managers.area(kInputs));
      managers.turn_buffer(kInputs);
    }
    const std::uint16_t error = error_code();
    if (error == errors_told) return;
    errors_told = error;
    mailbox.emergency(error, static_cast<std::uint8_t>(door.number(0x1001, 0)));
  }

  // A frame had to be thrown away.
  void count_error() {
    std::uint8_t& count = *memory.at(reg::kUnitErrors);
    count = static_cast<std::uint8_t>(count + (count < 0xff));
  }
  std::int64_t expired() const { return expired_; }
  const Memory& contents() const { return memory; }

 private:
  std::vector<std::uint8_t> image() const {
    const Identity identity = {door.number(0x1018, 1), door.number(0x1018, 2),
                               door.number(0x1018, 3), door.number(0x1018, 4),
                               "arm_emulator drive",   "Servo drives"};
    std::vector<Pdo> pdos = outputs.all();
    for (Pdo& pdo : inputs.all()) pdos.push_back(std::move(pdo));
    return sii_image(identity, pdos, 0);
  }

  // Slaves are switched on one after the other [ns].
  std::int64_t ahead() const { return 1'000'000'007LL * (drive + 1); }

  void describe_controller() {
    memory.put8(reg::kType, 0x11);
    memory.put16(reg::kType + 2, 2);
    memory.put8(reg::kFmmus, ethercat::kFmmus);
    memory.put8(reg::kSyncManagers, ethercat::kSyncManagers);
    memory.put8(reg::kRam, (kMemory - kRamBegin) / 1024);
    memory.put8(reg::kPorts, 0x0f);        // ports 0 and 1: MII
    memory.put16(reg::kFeatures, 0x018c);  // distributed clocks of 64 bits, bits in FMMUs
    memory.put32(reg::kDlControl, 1);
  }

  Fmmu fmmu(int k) const { return Fmmu(memory.at(reg::kFmmu + 16 * static_cast<std::size_t>(k))); }

  // Outputs: bytes of a datagram go to the memory. Single bits come with the rest of their bytes as
  // it is.
  bool take(const Fmmu& unit, std::uint32_t address, std::span<const std::uint8_t> data) {
    if (unit.whole_bytes()) {
      const Mapped one = unit.overlapping(address, data.size());
      return one.size > 0 && write(one.address, data.subspan(one.in_datagram, one.size));
    }
    const Mapped bits = unit.overlapping_bits(address, data.size());
    const std::size_t first = bits.address / 8, last = (bits.address + bits.size - 1) / 8;
    if (bits.size == 0 || last >= kMemory) return false;
    std::array<std::uint8_t, 2049> bytes;
    std::copy(memory.at(first), memory.at(last) + 1, bytes.begin());
    copy_bits(data.data(), bits.in_datagram, bytes.data(), bits.address - 8 * first, bits.size);
    return write(first, std::span(bytes).first(last + 1 - first));
  }
  // Inputs: the other way round.
  bool give(const Fmmu& unit, std::uint32_t address, std::span<std::uint8_t> data) {
    if (unit.whole_bytes()) {
      const Mapped one = unit.overlapping(address, data.size());
      return one.size > 0 && read(one.address, data.subspan(one.in_datagram, one.size), false);
    }
    const Mapped bits = unit.overlapping_bits(address, data.size());
    const std::size_t first = bits.address / 8, last = (bits.address + bits.size - 1) / 8;
    if (bits.size == 0 || last >= kMemory) return false;
    std::array<std::uint8_t, 2049> bytes;
    if (!read(first, std::span(bytes).first(last + 1 - first), false)) return false;
    copy_bits(bytes.data(), bits.address - 8 * first, data.data(), bits.in_datagram, bits.size);
    return true;
  }

  void before_read(std::size_t address, std::size_t size) {
    if (address >= kRamBegin) return;
    clock.before_read(address, size);
    if (overlap(address, size, reg::kDlStatus, 2)) {
      const bool closed = onward() != Onward::NEXT;
      // Ports 2 and 3 do not exist; port 0 leads to the master.
      memory.put16(reg::kDlStatus, static_cast<std::uint16_t>(0x5217 | (next ? 0x20 : 0) |
                                                              (closed ? 0x0400 : 0x0800)));
    }
    if (overlap(address, size, reg::kEvents, 2)) memory.put16(reg::kEvents, all_events());
  }
  std::uint16_t all_events() const {
    unsigned events = memory.get16(reg::kEvents) & 0x000fu;
    for (int k = 0; k < ethercat::kSyncManagers; ++k)
      if (managers.full(k)) events |= static_cast<unsigned>(event::kSyncManager0) << k;
    return static_cast<std::uint16_t>(events);
  }
  void after_read(std::size_t address, std::size_t size) {
    managers.close(address, size, [this](int k) {
      if (managers.written_by_master(k)) return;
      if (managers.mailbox(k)) {
        if (k == Mailbox::kIn)
          mailbox.read();
        else
          managers.set_full(k, false);
      }
      if (k == kInputs) read_ = true;
    });
    if (overlap(address, size, reg::kAlStatus, 2)) {
      const unsigned rest = memory.get16(reg::kEvents) & ~unsigned{event::kAlStatus};
      memory.put16(reg::kEvents, static_cast<std::uint16_t>(rest));
    }
  }
  void after_write(std::size_t address, std::span<const std::uint8_t> in) {
    const std::size_t size = in.size();
    managers.close(address, size, [this](int k) {
      if (!managers.written_by_master(k)) return;
      if (k == Mailbox::kOut && managers.mailbox(k))
        mailbox.written();
      else if (managers.mailbox(k))
        managers.set_full(k, true);
      else
        managers.turn_buffer(k);
      if (k == kOutputs) outputs_came();
    });
    if (address >= kRamBegin) return;
    if (overlap(address, size, reg::kErrors, reg::kErrorsEnd - reg::kErrors))
      memory.fill(reg::kErrors, reg::kErrorsEnd - reg::kErrors);  // any write clears them
    if (overlap(address, size, reg::kWatchdogCount, 2)) memory.put16(reg::kWatchdogCount, 0);
    sii.after_write(address, size);
    if (overlap(address, size, reg::kSyncManager, 8 * ethercat::kSyncManagers)) {
      managers.configure(address, size);
      mailbox.after_write();
      check_guards();
    }
    clock.after_write(address, size);
    if (clock.sets_pulses(address, size)) check_pulses();
    if (overlap(address, size, reg::kReset, 1)) reset_asked(in[reg::kReset - address]);
    if (overlap(address, size, reg::kAlControl, 1)) {
      al.request([this](State to) { return enter(to); });
      serve_areas();
    }
  }

  void outputs_came() {
    written_ = true;
    watchdog.trigger(now);
  }

  // ------------------------------------------------------------------------------------ states

  AlCode enter(State to) {
    const State from = al.state();
    if (to == State::OP) {
      watchdog.trigger(now);
      return AlCode::NONE;
    }
    if (to == State::SAFEOP && from == State::PREOP) return to_safeop();
    if (to == State::PREOP && from == State::INIT) {
      if (!mailboxes_fit()) return AlCode::MAILBOX;
      mailbox.begin();
      return AlCode::NONE;
    }
    leave(from, to);
    return AlCode::NONE;
  }
  AlCode to_safeop() {
    outputs.compile();
    inputs.compile();
    if (!fits(kOutputs, area::kOutputs, area::kInputs, outputs.size(), true))
      return AlCode::OUTPUTS;
    if (!fits(kInputs, area::kInputs, 0x1800, inputs.size(), false)) return AlCode::INPUTS;
    if (!pulses_fit()) return AlCode::SYNC0_CYCLE;
    drives_lock_mapping(all, drive, 1);
    written_ = read_ = false;
    if (inputs.size() > 0) inputs.from_drive(managers.area(kInputs));
    return AlCode::NONE;
  }
  // One or more steps down.
  void leave(State from, State to) {
    if (from == State::OP) drives_lost(all, drive, kLeftOpError);
    if (to == State::SAFEOP) return;
    if (from == State::SAFEOP || from == State::OP) drives_lock_mapping(all, drive, 0);
  }
  // An error takes it down.
  void fall(State to, AlCode why) {
    al.set(to, why);
    serve_areas();
  }
  // Mailboxes are served from PREOP on, process data from SAFEOP on (outputs too, which the drive
  // takes in OP only), and other areas never.
  void serve_areas() {
    const State state = al.state();
    for (int k = 0; k < ethercat::kSyncManagers; ++k) {
      const bool mail = k == Mailbox::kOut || k == Mailbox::kIn;
      const bool data = k == kOutputs || k == kInputs;
      managers.serve(k, (mail && state != State::INIT) ||
                            (data && (state == State::SAFEOP || state == State::OP)));
    }
  }

  bool mailboxes_fit() const {
    const auto sound = [this](int k, std::size_t start, bool by_master) {
      return managers.switched_on(k) && managers.mailbox(k) &&
             managers.written_by_master(k) == by_master && managers.start(k) == start &&
             managers.length(k) >= 34 && managers.length(k) <= area::kMailbox;
    };
    return sound(Mailbox::kOut, area::kMailboxOut, true) &&
           sound(Mailbox::kIn, area::kMailboxIn, false);
  }
  // Buffers of process data: three of them lie one after the other.
  bool fits(int k, std::size_t start, std::size_t end, std::size_t size, bool by_master) const {
    if (size == 0) return !managers.switched_on(k) || managers.length(k) == 0;
    return managers.switched_on(k) && !managers.mailbox(k) &&
           managers.written_by_master(k) == by_master && managers.start(k) == start &&
           managers.length(k) == size && start + 3 * size <= end;
  }
  // A master that changes the guards of an area in use loses what depended on it.
  void check_guards() {
    const State state = al.state();
    if (state == State::INIT) return;
    if (!mailboxes_fit()) {
      leave(state, State::INIT);
      fall(State::INIT, AlCode::MAILBOX);
      return;
    }
    if (!exchanges()) return;
    const bool out = fits(kOutputs, area::kOutputs, area::kInputs, outputs.size(), true);
    if (out && fits(kInputs, area::kInputs, 0x1800, inputs.size(), false)) return;
    leave(state, State::PREOP);
    fall(State::PREOP, out ? AlCode::INPUTS : AlCode::OUTPUTS);
  }

  // An exchange stands for whole servo periods.
  bool pulses_fit() const {
    return !clock.sync0() || (clock.sync0_cycle() != 0 && clock.sync0_cycle() % period == 0);
  }
  // The same where a master sets SYNC0 late.
  void check_pulses() {
    if (!exchanges() || pulses_fit()) return;
    leave(al.state(), State::PREOP);
    fall(State::PREOP, AlCode::SYNC0_CYCLE);
  }

  // "R", "E", "S" one after the other reset the controller.
  void reset_asked(std::uint8_t letter) {
    static constexpr std::uint8_t kWord[] = {'R', 'E', 'S'};
    reset_letters = letter == kWord[reset_letters] ? reset_letters + 1 : letter == 'R' ? 1 : 0;
    if (reset_letters < 3) return;
    reset_letters = 0;
    leave(al.state(), State::INIT);
    memory = Memory();
    describe_controller();
    sii.reload();
    clock.begin(ahead());
    watchdog.begin();
    fall(State::INIT, AlCode::NONE);
  }

  std::uint16_t error_code() const { return static_cast<std::uint16_t>(door.number(0x603f, 0)); }

  drives* const all;
  const std::int32_t drive;
  const std::int64_t period;
  const Door door;
  Memory memory;
  SyncManagers managers;
  ProcessData outputs, inputs;
  Sii sii;
  DistributedClock clock;
  Watchdog watchdog;
  Mailbox mailbox;
  AlState al;
  std::int64_t now = 0;                  // ns, time of the segment
  bool next = false;                     // a slave is connected behind this one
  bool written_ = false, read_ = false;  // since the last servo period
  std::uint16_t errors_told = 0;
  int reset_letters = 0;
  std::int64_t expired_ = 0;
};

}  // namespace ethercat
