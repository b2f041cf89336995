// One CiA 402 drive: its dictionary, its state machine, and what its motor gets in a servo period.
//
// A bus reads and writes between two periods. In `begin_period` the drive takes the controlword and
// its targets, in `end_period` what was measured.
#pragma once

#include "cia402.hpp"
#include "drives.h"
#include "values.hpp"

namespace fieldbus {

class Drive {
 public:
  // `joint` must outlive the drive.
  Drive(const drives_joint& joint, const drives_machine& machine)
      : joint_(joint), values_(static_cast<Bus>(machine.bus)) {
    (void)joint_;
    values_.set_text(0x1008, machine.device_name);
    values_.set_text(0x1009, "1.0");
    values_.set_text(0x100A, "1.0");
  }

  const Values& values() const { return values_; }
  const StateMachine& machine() const { return machine_; }

  // Read or write an entry: 0, or the abort code of an SDO server; a refused access changes
  // nothing.
  std::uint32_t read(std::uint16_t index, std::uint8_t sub, std::span<std::byte> out,
                     std::size_t& size) const {
    return values_.read(index, sub, out, size);
  }
  std::uint32_t write(std::uint16_t index, std::uint8_t sub, std::span<const std::byte> in) {
    int slot = -1;
    std::int64_t value = 0;
    const std::uint32_t abort = values_.check(index, sub, in, slot, value);
    return abort ? abort : take(slot, value);
  }

  // Process data. What is mapped is in values().mapping(...), values().process_data(...).
  void read_mapped(const Mapped& one, std::byte* out) const {
    if (one.slot < 0)
      std::memset(out, 0, static_cast<std::size_t>(one.bits) / 8);
    else
      std::memcpy(out, values_.place(one.slot), static_cast<std::size_t>(one.bits) / 8);
  }
  // A value out of its range is not taken; its abort code is returned.
  std::uint32_t write_mapped(const Mapped& one, const std::byte* in) {
    if (one.slot < 0) return abort_code::none;
    const std::int64_t value = Values::number(Values::entry(one.slot), in);
    const std::uint32_t abort = values_.check_value(one.slot, value);
    return abort ? abort : take(one.slot, value);
  }

  void lock_mapping(bool locked) { values_.mapping_locked = locked; }

  // Begin anew where the motor is now.
  void begin(const arm_joint_measurement& measured, const arm_joint_sensors& sensors,
             bool powered) {
    machine_.begin();
    end_period(measured, sensors, powered);
  }
  // Values as they were made, Switch on disabled.
  void restart() {}
  // The master is gone.
  void lost(std::uint16_t error) { (void)error; }

  // What the motor gets in the servo period that begins now.
  arm_joint_command begin_period() { return {ARM_VOLTAGE, 0, 0.0}; }
  // What was measured when it ended.
  void end_period(const arm_joint_measurement& measured, const arm_joint_sensors& sensors,
                  bool powered) {
    (void)measured, (void)sensors, (void)powered;
  }
  // The machine has diverged.
  void diverged() {}

 private:
  std::uint32_t take(int slot, std::int64_t value) {
    values_.set_at(slot, value);
    return abort_code::none;
  }

  const drives_joint& joint_;
  Values values_;
  StateMachine machine_;
};

}  // namespace fieldbus
