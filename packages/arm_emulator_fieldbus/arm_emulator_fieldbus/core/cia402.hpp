// The state machine of a drive after CiA 402 (IEC 61800-7-201), independent of the bus.
//
//   0, 1  start-up, then Switch on disabled      9  Operation enabled -> Switch on disabled
//   2  Switch on disabled -> Ready               10  Switched on -> Switch on disabled
//   3  Ready -> Switched on                      11  Operation enabled -> Quick stop active
//   4  Switched on -> Operation enabled          12  Quick stop active -> Switch on disabled
//   5  Operation enabled -> Switched on          13  any -> Fault reaction active
//   6  Switched on -> Ready                      14  Fault reaction active -> Fault
//   7  Ready -> Switch on disabled               15  Fault -> Switch on disabled
//   8  Operation enabled -> Ready                16  Quick stop active -> Operation enabled
#pragma once

#include <cstdint>

namespace fieldbus {

enum class State : std::uint8_t {
  not_ready,
  switch_on_disabled,
  ready,
  switched_on,
  operation_enabled,
  quick_stop,
  fault_reaction,
  fault,
};

// Bits of the controlword 0x6040.
namespace control {
inline constexpr std::uint16_t switch_on = 1 << 0, enable_voltage = 1 << 1, quick_stop = 1 << 2,
                               enable_operation = 1 << 3, new_set_point = 1 << 4,
                               change_at_once = 1 << 5, relative = 1 << 6, fault_reset = 1 << 7,
                               halt = 1 << 8, start_homing = 1 << 4;
}  // namespace control

// Bits of the statusword 0x6041.
namespace status {
inline constexpr std::uint16_t ready = 1 << 0, switched_on = 1 << 1, operation_enabled = 1 << 2,
                               fault = 1 << 3, voltage_enabled = 1 << 4, no_quick_stop = 1 << 5,
                               switch_on_disabled = 1 << 6, warning = 1 << 7, remote = 1 << 9,
                               target_reached = 1 << 10, internal_limit = 1 << 11, bit12 = 1 << 12,
                               bit13 = 1 << 13;
}  // namespace status

// Error codes, 0x603F.
namespace error_code {
inline constexpr std::uint16_t undervoltage = 0x3220, too_hot = 0x4310, software = 0x6100,
                               following_error = 0x8611;
}  // namespace error_code

// Commands in bits 0 to 3 of a controlword.
enum class Command : std::uint8_t {
  shutdown,
  switch_on,
  disable_voltage,
  quick_stop,
  enable_operation,
};
constexpr Command command_of(std::uint16_t word) {
  if (!(word & control::enable_voltage)) return Command::disable_voltage;
  if (!(word & control::quick_stop)) return Command::quick_stop;
  if (!(word & control::switch_on)) return Command::shutdown;
  return word & control::enable_operation ? Command::enable_operation : Command::switch_on;
}

// Kinds of stop, selected by the options 0x605A to 0x605E.
enum class Stop : std::uint8_t {
  none,          // keep going
  profile_ramp,  // slow down by 0x6084
  quick_ramp,    // slow down by 0x6085
  torque_limit,  // slow down by the largest torque
};

// Options set by the master.
struct StopOptions {
  std::int16_t quick_stop = 2, shutdown = 0, disable = 1, halt = 1, fault = 2;
};

class StateMachine {
 public:
  State state() const { return state_; }
  // Present kind of stop.
  Stop stop() const { return stop_; }
  std::uint16_t error() const { return error_; }
  // Whether the motor is controlled: also while its brake opens, before transition 4.
  bool controls() const {
    return state_ == State::operation_enabled || state_ == State::quick_stop ||
           state_ == State::fault_reaction || opening_;
  }

  // Start up: transitions 0 and 1.
  void begin() {
    *this = StateMachine{};
    change_state(1, State::switch_on_disabled);
  }

  // Take a controlword, once per period. `voltage`: whether the supply is there; `released`:
  // whether the brake is open; `cause`: whether the cause of a fault is still present.
  void take(std::uint16_t word, const StopOptions& options, bool voltage, bool released,
            bool cause) {
    opening_ = false;
    const bool reset = (word & control::fault_reset) && !(word_ & control::fault_reset);
    word_ = word;
    const Command command = command_of(word);
    switch (state_) {
      case State::not_ready:
      case State::fault_reaction:
        return;
      case State::fault:
        if (reset && !cause) {
          error_ = 0;
          change_state(15, State::switch_on_disabled);
        }
        return;
      case State::switch_on_disabled:
        if (command == Command::shutdown) change_state(2, State::ready);
        return;
      case State::ready:
        if (command == Command::disable_voltage || command == Command::quick_stop)
          change_state(7, State::switch_on_disabled);
        else if (command != Command::shutdown && voltage)
          change_state(3, State::switched_on);
        return;
      case State::switched_on:
        if (command == Command::disable_voltage || command == Command::quick_stop)
          change_state(10, State::switch_on_disabled);
        else if (command == Command::shutdown || !voltage)
          change_state(6, State::ready);
        else if (command == Command::enable_operation && released)
          change_state(4, State::operation_enabled);
        else if (command == Command::enable_operation)
          opening_ = true;
        return;
      case State::operation_enabled:
        apply_command(command, options);
        return;
      case State::quick_stop:
        if (command == Command::disable_voltage)
          change_state(12, State::switch_on_disabled);
        else if (command == Command::enable_operation && options.quick_stop >= 5)
          change_state(16, State::operation_enabled);
        return;
    }
  }

  // The motor stands after a stop.
  void finish_stop(const StopOptions& options) {
    if (stop_ == Stop::none) return;
    if (state_ == State::fault_reaction)
      change_state(14, State::fault);
    else if (state_ == State::quick_stop && options.quick_stop < 5)
      change_state(12, State::switch_on_disabled);
    else if (state_ == State::operation_enabled)
      change_state(leaving_, leaving_ == 8 ? State::ready : State::switched_on);
  }

  // A fault occurred. `can_stop`: whether the motor can still be slowed down.
  void fail(std::uint16_t error, const StopOptions& options, bool can_stop) {
    if (state_ == State::fault || state_ == State::fault_reaction) {
      if (!can_stop && state_ == State::fault_reaction) change_state(14, State::fault);
      return;
    }
    error_ = error;
    const bool moves = state_ == State::operation_enabled || state_ == State::quick_stop;
    change_state(13, State::fault_reaction);
    const auto way = static_cast<Stop>(options.fault);
    if (moves && can_stop && options.fault > 0)
      stop_ = way;
    else
      change_state(14, State::fault);
  }

  // The master is lost; 0x6007 states the reaction. A drive whose motor is not controlled returns
  // to Switch on disabled.
  void handle_master_loss(std::int64_t reaction, std::uint16_t error, const StopOptions& options,
                          bool can_stop) {
    constexpr std::int64_t fault = 1, disable = 2;
    opening_ = false;
    const bool moves = state_ == State::operation_enabled || state_ == State::quick_stop;
    if (state_ == State::ready)
      change_state(7, State::switch_on_disabled);
    else if (state_ == State::switched_on)
      change_state(10, State::switch_on_disabled);
    else if (moves && reaction == fault)
      fail(error, options, can_stop);
    else if (state_ == State::quick_stop && reaction == disable)
      change_state(12, State::switch_on_disabled);
    else if (state_ == State::operation_enabled)
      apply_command(reaction == disable ? Command::disable_voltage : Command::quick_stop, options);
  }

  // Bits 0 to 3, 5 and 6 of the statusword.
  std::uint16_t status() const {
    using namespace fieldbus::status;
    constexpr std::uint16_t on = fieldbus::status::ready | switched_on;
    constexpr std::uint16_t operates = on | operation_enabled;
    // In the order of the states.
    static constexpr std::uint16_t kBits[] = {0,
                                              fieldbus::status::switch_on_disabled,
                                              fieldbus::status::ready | no_quick_stop,
                                              on | no_quick_stop,
                                              operates | no_quick_stop,
                                              operates,
                                              operates | fieldbus::status::fault,
                                              fieldbus::status::fault};
    return kBits[static_cast<int>(state_)];
  }

 private:
  // The number of the transition is for the reader.
  void change_state(int /*transition*/, State state) {
    state_ = state;
    stop_ = Stop::none;
    leaving_ = 0;
    opening_ = false;
  }
  void leave(int transition, State state, std::int16_t option) {
    if (option == 0) {
      change_state(transition, state);
    } else {  // once the motor stands
      stop_ = Stop::profile_ramp;
      leaving_ = transition;
    }
  }
  void apply_command(Command command, const StopOptions& options) {
    switch (command) {
      case Command::enable_operation:
        stop_ = Stop::none;
        leaving_ = 0;
        return;
      case Command::switch_on:
        if (leaving_ != 5) leave(5, State::switched_on, options.disable);
        return;
      case Command::shutdown:
        if (leaving_ != 8) leave(8, State::ready, options.shutdown);
        return;
      case Command::disable_voltage:
        change_state(9, State::switch_on_disabled);
        return;
      case Command::quick_stop:
        change_state(11, State::quick_stop);
        if (options.quick_stop == 0) {
          change_state(12, State::switch_on_disabled);
        } else {
          const int way = options.quick_stop < 5 ? options.quick_stop : options.quick_stop - 4;
          stop_ = way < 3 ? static_cast<Stop>(way) : Stop::torque_limit;
        }
        return;
    }
  }

  State state_ = State::not_ready;
  Stop stop_ = Stop::none;
  std::uint16_t word_ = 0, error_ = 0;
  bool opening_ = false;
  int leaving_ = 0;  // transition that follows when the motor stands; 0: none
};

}  // namespace fieldbus
