// One CiA 402 drive: its dictionary, its state machine, and its motor's command per servo period.
//
// A bus reads and writes between two periods. In `begin_period` the drive takes the controlword and
// its targets, in `end_period` measurements. What a mode of operation makes of the targets is
// in modes/; the drive asks the mode that is chosen, and knows none by its number.
#pragma once

#include "cia402.hpp"
#include "declared_values.hpp"
#include "drive_defaults.hpp"
#include "drives.h"
#include "fault_window.hpp"
#include "inner_loops.hpp"
#include "modes/modes.hpp"
#include "stopping.hpp"
#include "touch_probe.hpp"

namespace fieldbus {

class Drive {
 public:
  // `joint` and `machine` must outlive the drive, and the drive its place.
  Drive(const drives_joint& joint, const drives_machine& machine, int number)
      : axis_(joint, machine),
        loops_(joint.servo),
        declared_(machine, number),
        faults_(machine),
        supply_(machine.supply_voltage),
        number_(number) {
    axis_.values.set_text(0x1008, machine.device_name);
    axis_.values.set_text(0x1009, "1.0");
    axis_.values.set_text(0x100A, "1.0");
    set_defaults(axis_, number_);
    faults_.begin(axis_.values);
  }

  const Values& values() const { return axis_.values; }
  int periods_per_target() const { return axis_.periods_per_target(); }

  // ------------------------------------------------------------------------------------ dictionary

  // Read or write an entry: 0, or the abort code of an SDO server; a refused access changes
  // nothing.
  std::uint32_t read(std::uint16_t index, std::uint8_t sub, std::span<std::byte> out,
                     std::size_t& size) {
    if (index == FaultWindow::kMagnitude) faults_.show(axis_.values);
    return axis_.values.read(index, sub, out, size);
  }
  std::uint32_t write(std::uint16_t index, std::uint8_t sub, std::span<const std::byte> in) {
    int slot = -1;
    std::int64_t value = 0;
    std::uint32_t abort = axis_.values.check(index, sub, in, slot, value);
    if (!abort) abort = take(slot, value);
    if (!abort && index >= 0x1005 && index < 0x2000) ++communication_;
    return abort;
  }
  // Times that an object of the communication was written.
  std::uint32_t communication() const { return communication_; }
  // Set an entry that belongs to the bus, whatever its access; false: the dictionary has no such
  // entry.
  bool set(std::uint16_t index, std::uint8_t sub, std::int64_t value) {
    const int slot = axis_.values.find(index, sub);
    if (slot >= 0) axis_.values.set_at(slot, value);
    return slot >= 0;
  }

  // Process data. The mapping is in values().mapping(...), values().process_data(...).
  void read_mapped(const Mapped& one, std::byte* out) const {
    if (one.slot < 0)
      std::memset(out, 0, static_cast<std::size_t>(one.bits) / 8);
    else
      std::memcpy(out, axis_.values.place(one.slot), static_cast<std::size_t>(one.bits) / 8);
  }
  // A value out of its range is refused; its abort code is returned.
  std::uint32_t write_mapped(const Mapped& one, const std::byte* in) {
    if (one.slot < 0) return abort_code::none;
    const std::int64_t value = Values::number(Values::entry(one.slot), in);
    const std::uint32_t abort = axis_.values.check_value(one.slot, value);
    return abort ? abort : take(one.slot, value);
  }
  void lock_mapping(bool locked) { axis_.values.mapping_locked = locked; }

  // -------------------------------------------------------------------------------------- its life

  // Restart at the motor's present position.
  void begin(const arm_joint_measurement& measured, const arm_joint_sensors& sensors,
             bool powered) {
    loops_.begin();
    axis_.shift = 0;
    axis_.measured.diverged = false;
    look(measured, sensors, powered);
    restart();
  }
  // Initial values, Switch on disabled.
  void restart() {
    Values& values = axis_.values;
    const bool locked = values.mapping_locked;
    values.restore();
    values.mapping_locked = locked;
    axis_.interpolation_given = false;
    set_defaults(axis_, number_);
    faults_.begin(axis_.values);
    machine_.begin();
    mode_.choose(0);
    axis_.shift = axis_.targets = 0;
    closing_ = lost_ = false;
    probe_[0] = probe_[1] = TouchProbe{};
    hold();
    publish();
  }
  // Cycle of the bus [ns]; 0: unknown.
  void set_cycle(std::int64_t cycle) {
    axis_.cycle = cycle;
    if (axis_.interpolation_given) return;
    set_interpolation_time(axis_.values, cycle ? cycle : axis_.period);
  }
  // The master is gone.
  void lost(std::uint16_t error) {
    const std::int64_t reaction = get<0x6007>();
    if (!reaction) return;
    const State before = machine_.state();
    machine_.handle_master_loss(reaction, error, options(), axis_.measured.powered);
    note_failure(before);
    axis_.values.set<0x6040>(0);
    lost_ = true;
    publish();
  }
  // The machine has diverged, and keeps its state.
  void handle_divergence() {
    axis_.measured.diverged = true;
    fail(error_code::software, false);
  }

  // ---------------------------------------------------------------------------------- servo period

  // Return the motor's command for the servo period that begins now.
  arm_joint_command begin_period() {
    const Measured& now = axis_.measured;
    axis_.word_before = axis_.word;
    axis_.word = static_cast<std::uint16_t>(get<0x6040>());
    if (!lost_)
      machine_.take(axis_.word, options(), now.powered, !now.brake, now.diverged || now.hot);
    closing_ = closing_ && !now.brake && now.powered && !machine_.controls();
    choose_mode();
    if (!machine_.controls() && !closing_) return release_motor();
    if (!controlled_) hold();
    controlled_ = true;
    const double command = move();
    if (!machine_.controls() && !closing_) return release_motor();  // a stop has come to its end
    const bool close = closing_ || closed_by_output();
    const std::uint32_t enable = ARM_ENABLED | (close ? std::uint32_t{ARM_CLOSE_BRAKE} : 0U);
    return {axis_.joint.mode, enable, command};
  }
  // Write what the motor gets beside it into the rows of arm_command.further.
  void put_further(double* further) const { declared_.command(axis_.values, further); }
  // Take the measurement at its end.
  void end_period(const arm_joint_measurement& measured, const arm_joint_sensors& sensors,
                  bool powered) {
    look(measured, sensors, powered);
    watch();
    mode_->look(axis_);
    look_at_probes();
    publish();
  }

 private:
  template <std::uint16_t index, std::uint8_t sub = 0>
  std::int64_t get() const {
    return axis_.values.get<index, sub>();
  }

  // --------------------------------------------------------------------------- values that are set

  // Take a value that is in the range of its entry.
  std::uint32_t take(int slot, std::int64_t value) {
    constexpr std::int64_t load = 0x64616F6C;  // "load", by which CiA 301 restores
    if (declared_.is_refused(slot, value)) return abort_code::out_of_range;
    switch (Values::entry(slot).index) {
      case 0x1003:
        if (value != 0) return abort_code::out_of_range;
        axis_.values.forget_errors();
        return abort_code::none;
      case 0x1010:
        return abort_code::cannot_store;  // there is nowhere to store them
      case 0x1011:
        return value == load ? abort_code::none : abort_code::cannot_store;
      case FaultWindow::kNumber:
        return faults_.choose(axis_.values, value);
      case FaultWindow::kMagnitude:
        return faults_.set(axis_.values, value);
      case 0x6060:
        if (value && !(get<0x6502>() >> (value - 1) & 1)) return abort_code::out_of_range;
        break;
      case 0x6098:
        if (!Homing::known(value, axis_.joint.index != 0, axis_.joint.stops != 0))
          return abort_code::out_of_range;
        break;
      case 0x607A:
        ++axis_.targets;
        break;
      case 0x60B8:
        for (int k = 0; k < 2; ++k)
          if (!TouchProbe::known(select_probe_function(value, k), axis_.joint.index != 0))
            return abort_code::out_of_range;
        break;
      case 0x60C2:
        axis_.interpolation_given = true;
        break;
      case 0x6040:
        lost_ = false;
        break;
      default:
        break;
    }
    axis_.values.set_at(slot, value);
    return abort_code::none;
  }

  StopOptions options() const {
    const auto option = [](std::int64_t value) { return static_cast<std::int16_t>(value); };
    return {option(get<0x605A>()), option(get<0x605B>()), option(get<0x605C>()),
            option(get<0x605D>()), option(get<0x605E>())};
  }
  bool brakes() const { return axis_.joint.brake != 0; }
  bool closed_by_output() const { return brakes() && get<0x60FE, 1>() & get<0x60FE, 2>() & 1; }

  // -------------------------------------------------------------------------------------- a period

  void choose_mode() {
    const std::int64_t requested = get<0x6060>();
    if (requested == mode_.about().number) return;
    mode_.choose(requested);
    if (controlled_) mode_->take_over(axis_);
  }
  // The command is 0; the brake closes.
  arm_joint_command release_motor() {
    hold();
    controlled_ = false;
    loops_.release();
    axis_.limited = 0;
    return {axis_.joint.mode, 0, 0.0};
  }
  void hold() {
    axis_.follow_motor();
    stopping_.end();
    mode_->hold(axis_);
  }

  // Set the demands of this period; return the command.
  double move() {
    axis_.demand.speed_cut = false;
    const bool operates = machine_.state() == State::operation_enabled;
    const bool halts = operates && (axis_.word & control::halt) && mode_.about().number;
    const Stop stop = machine_.stop();
    if (stop != Stop::none) {
      slow_down(stop, false);
    } else if (halts) {
      slow_down(static_cast<Stop>(get<0x605D>()), true);
    } else {
      if (stopping_.halted()) mode_->resume(axis_, stopping_.by_halt());
      stopping_.end();
      operates ? mode_->run(axis_) : axis_.hold_standstill();
    }
    Offsets offsets;
    if (machine_.state() == State::operation_enabled) offsets = mode_->compute_offsets(axis_);
    if (stopping_.halted()) offsets.speed = 0.0;
    return loops_.command(axis_, offsets, mode_->find_torque_limit(axis_),
                          mode_.about().within_limits);
  }
  void slow_down(Stop way, bool by_halt) {
    if (!stopping_.halted() && machine_.state() == State::fault_reaction) {
      axis_.demand.speed = axis_.measured.speed;  // it may be far from its demand
      axis_.demand.loop = Loop::speed;
    }
    stopping_.begin(by_halt);
    if (by_halt && mode_.about().halts_in_torque) return stopping_.reduce_torque(axis_);
    stopping_.slow_down(axis_, way);
    if (!stopping_.stands() || by_halt) return;
    const State before = machine_.state();
    machine_.finish_stop(options());
    const bool left = machine_.state() != before;
    // The motor is held until its brake has closed.
    closing_ = left && !machine_.controls() && brakes();
  }

  // ----------------------------------------------------------------------------- what was measured

  void look(const arm_joint_measurement& measured, const arm_joint_sensors& sensors, bool powered) {
    Measured& now = axis_.measured;
    loops_.observe(measured, axis_);
    now.index = sensors.index;
    now.pulses = sensors.index_pulses;
    now.brake = measured.brake != 0;
    now.hot = (measured.faults & ARM_FAULT_THERMAL) != 0;
    now.diverged = now.diverged || (measured.faults & ARM_FAULT_DIVERGED) != 0;
    now.powered = powered;
  }

  void fail(std::uint16_t error, bool can_stop) {
    const State before = machine_.state();
    machine_.fail(error, options(), can_stop && axis_.measured.powered);
    if (!can_stop) closing_ = false;
    note_failure(before);
  }
  // Keep the error that has led to a fault from another state.
  void note_failure(State before) {
    const auto failed = [](State one) {
      return one == State::fault || one == State::fault_reaction;
    };
    if (failed(before) || !failed(machine_.state())) return;
    stopping_.end();
    axis_.values.add_error(machine_.error());
  }

  void watch() {
    const Measured& now = axis_.measured;
    const State state = machine_.state();
    const bool on = state == State::operation_enabled || state == State::quick_stop;
    if (now.diverged) fail(error_code::software, false);
    if (now.hot && (on || state == State::fault_reaction)) fail(error_code::too_hot, false);
    if (!now.powered && (on || state == State::fault_reaction))
      fail(error_code::undervoltage, false);
    const std::int64_t window = get<0x6065>();
    const bool follows = on && axis_.demand.loop == Loop::position && mode_.about().follows;
    const double error = axis_.demand.position - axis_.counts();
    off_ = follows && window != 4294967295 && std::fabs(error) > static_cast<double>(window);
    off_for_.look(off_, axis_.dt);
    if (off_for_.time > 1e-3 * axis_.number<0x6066>() + 0.5 * axis_.dt)
      fail(error_code::following_error, true);
  }
  static unsigned select_probe_function(std::int64_t both, int probe) {
    return static_cast<unsigned>(both >> (8 * probe)) & 0xffU;
  }
  void look_at_probes() {
    for (int k = 0; k < 2; ++k) {
      if (!probe_[k].look(select_probe_function(get<0x60B8>(), k), axis_.measured.pulses)) continue;
      const std::int64_t at = word_of(axis_.measured.index - axis_.shift);
      if (k)
        axis_.values.set<0x60BC>(at);
      else
        axis_.values.set<0x60BA>(at);
    }
  }

  // --------------------------------------------------------------------------- reports to a master

  std::uint16_t status() const {
    using namespace fieldbus::status;
    const bool operates = machine_.state() == State::operation_enabled;
    const bool limited = axis_.demand.speed_cut || axis_.demand.position_cut || axis_.limited;
    std::uint16_t word = machine_.status() | remote;
    if (axis_.measured.powered) word |= voltage_enabled;
    if (off_) word |= warning;
    if (operates && limited) word |= internal_limit;
    const bool halts = operates || machine_.state() == State::quick_stop;
    if (halts && stopping_.stands()) word |= target_reached;
    const bool stops = machine_.stop() != Stop::none;
    return word | mode_->compute_status(axis_, {operates, stops, stopping_.halted(), off_});
  }

  std::uint8_t error_register() const {
    const std::uint16_t error = machine_.error();
    if (!error) return 0;
    switch (error >> 12) {
      case 3:
        return 0x05;
      case 4:
        return 0x09;
      case 8:
        return error == error_code::following_error ? 0x21 : 0x11;
      default:
        return 0x01;
    }
  }

  void publish() {
    Values& of = axis_.values;
    const Measured& now = axis_.measured;
    const Demand& demand = axis_.demand;
    const bool in_position = demand.loop == Loop::position, in_torque = demand.loop == Loop::torque;
    const std::int64_t demanded =
        in_position ? static_cast<std::int64_t>(std::floor(demand.position + 0.5)) : now.counts;
    of.set<0x1001>(error_register());
    of.set<0x2004>(now.brake);
    of.set<0x2005>(to_integer(1e3 * loops_.current(), 32));
    of.set<0x2006>(to_integer(1e3 * now.command, 32));
    of.set<0x603F>(machine_.error());
    of.set<0x6041>(status());
    of.set<0x6061>(mode_.about().number);
    of.set<0x6062>(word_of(demanded - axis_.shift));
    of.set<0x6063>(word_of(now.counts));
    of.set<0x6064>(word_of(now.counts - axis_.shift));
    of.set<0x6069>(to_integer(static_cast<double>(now.turned) / axis_.dt, 32));
    of.set<0x606B>(to_integer(in_torque ? now.speed : demand.speed, 32));
    of.set<0x606C>(to_integer(now.speed, 32));
    of.set<0x6074>(to_integer(in_torque ? demand.torque : now.torque, 16));
    of.set<0x6077>(to_integer(now.torque, 16));
    of.set<0x6078>(to_integer(1e6 * loops_.current() / axis_.units.rated_current, 16));
    of.set<0x6079>(now.powered ? to_integer(1e3 * supply_, 32, false) : 0);
    of.set<0x60B9>(probe_[0].status() | probe_[1].status() << 8);
    of.set<0x60F4>(in_position ? to_integer(demand.position - axis_.counts(), 32) : 0);
    of.set<0x60FC>(word_of(demanded));
    of.set<0x60FD>(now.brake ? 1 << 16 : 0);
    declared_.publish(of);
  }

  Axis axis_;
  InnerLoops loops_;
  const DeclaredValues declared_;
  const FaultWindow faults_;
  const double supply_;  // V
  const int number_;

  std::uint32_t communication_ = 0;
  StateMachine machine_;
  Modes mode_;
  Stopping stopping_;
  TouchProbe probe_[2];
  bool controlled_ = false;  // the loops command the motor
  bool closing_ = false;     // ... while its brake closes behind a stop
  bool lost_ = false;        // the master is gone, until it writes a controlword
  bool off_ = false;         // the following error is beyond its window
  Lasting off_for_;
};

}  // namespace fieldbus
