// A scene's machine behind arm.h: its sensors, its commands and its checks.
//
// One class, with a member for each function of arm.h, hence the length.
#pragma once

#include <time.h>

#include <cstddef>

#include "arm.h"
#include "boundary/io_links.hpp"
#include "machine/machine.hpp"
#include "mechanics/sensors.hpp"

// Digest of the sources of a scene's library; set on the compiler's command line (compiler.py).
#ifndef ARM_FINGERPRINT
#define ARM_FINGERPRINT 0
#endif
// Version of the arithmetic, likewise (toolchain/flags.py).
#ifndef ARM_ARITHMETIC
#define ARM_ARITHMETIC 0
#endif

namespace arm {

// Texts of a refusal are cut to the room.
template <int room>
void write_text(char (&to)[room], const char* text) {
  int length = 0;
  for (; text[length] && length < room - 1; ++length) to[length] = text[length];
  to[length] = 0;
}

// The enum arm_mode of each drive's commands.
struct CommandModes {
  std::int32_t at[Scene::N] = {};
  constexpr CommandModes() {
    for_each_drive<Scene>(
        [&](const auto& drive, int j) { at[j] = static_cast<std::int32_t>(drive.motor.takes); });
  }
};
inline constexpr CommandModes kModes;

// Whether drive j has a sensor of a field, of the readings that of a row.
template <class S>
bool has_sensor([[maybe_unused]] int j, [[maybe_unused]] Field field,
                [[maybe_unused]] int row = 0) {
  bool is_present = false;
  if constexpr (Sensors<S>::present)
    std::apply(
        [&]<class... Rows>(const Rows&... rows) {
          ((is_present |= Rows::Quantity::field == field && row-- == 0 && rows.at[j].present), ...);
        },
        Sensors<S>::structure.analog);
  return is_present;
}

// The drive of the deflection in a row of readings at a joint; -1: none.
template <class S>
constexpr int find_deflection([[maybe_unused]] int row, [[maybe_unused]] int joint) {
  if constexpr (kDeflects<S>)
    return S::deflection[row][joint];
  else
    return -1;
}

template <class S>
int describe_reading(int reading, int joint, arm_reading* out) {
  if constexpr (S::readings > 0) {
    const Reading& source = S::reading[reading];
    const int drive = drive_of<S>(joint), sensor = reading - count_deflections<S>();
    const bool slides = joint_kind<S>(drive) != JointKind::revolute;
    out->present = sensor < 0 ? find_deflection<S>(reading, joint) >= 0
                              : has_sensor<S>(drive, Field::reading, sensor);
    out->name = source.name, out->unit = slides ? source.unit_of_slides : source.unit;
  }
  return ARM_OK;
}

}  // namespace arm

struct arm_machine {
  using Machine = arm::Machine<Scene>;
  // Drives of the machine, and joints of arm.h: those that controllers know.
  static constexpr int N = Scene::N, J = arm::count_joints<Scene>();

  // Values of the varied numbers and the brakes, and one that is 0.
  using Values = double[arm::kOwnNumbers<Scene> + 1];

  // Saved numbers, eight bytes each in a fixed order: a digest of the library, then the machine.
  template <class Number>
  static void for_each_saved_number(arm_machine& machine, Machine::FullState& full, Values& values,
                                    Number&& number) {
    number(machine.step);
    number(machine.steps_per_period);
    full.for_each_number(number);
    machine.sensors.for_each_number(number);
    machine.io_links.for_each_number(number);
    number(machine.answered);
    for (double& value : machine.applied) number(value);
    number(machine.powered);
    for (double& value : values) number(value);
    if constexpr (Scene::external_wrench)
      for (arm::GivenWrench& wrench : machine.wrenches)
        for (double& entry : wrench.numbers) number(entry);
  }

  explicit arm_machine(const arm_options& options)
      : machine(options.step, options.core, options.parameters),
        step(options.step),
        steps_per_period(options.steps_per_period) {}

  ARM_ONCE int refuse(int joint, const char* quantity, const char* rule, double got) const {
    why.joint = joint;
    arm::write_text(why.quantity, quantity);
    arm::write_text(why.rule, rule);
    why.got = got;
    return ARM_REFUSED;
  }
  // ARM_OK unless a required pointer is null.
  int check_pointer(const void* pointer, const char* quantity) const {
    return pointer ? ARM_OK : refuse(-1, quantity, "be there, no null pointer", 0.0);
  }
  int check_count(std::int64_t count, const char* quantity) const {
    return count >= 0 ? ARM_OK : refuse(-1, quantity, "be at least 0", static_cast<double>(count));
  }
  // ARM_OK if all numbers of a row of joints are finite.
  int check_finite(const double* row, const char* quantity) const {
    if (check_pointer(row, quantity)) return ARM_REFUSED;
    for (int j = 0; j < J; ++j)
      if (!arm::is_finite(row[j])) return refuse(j, quantity, "be finite", row[j]);
    return ARM_OK;
  }
  // A struct may be as short as it was in version 1 of arm.h.
  template <class Struct>
  int check_size(const Struct* record, std::size_t smallest = sizeof(Struct)) const {
    if (check_pointer(record, "struct")) return ARM_REFUSED;
    if (record->size >= smallest) return ARM_OK;
    return refuse(-1, "size", "be that of the struct in arm.h", record->size);
  }

  int check_measurement(const arm_measurement* out) const {
    if (check_size(out, offsetof(arm_measurement, sensors))) return ARM_REFUSED;
    return check_pointer(out->joint, "joint of the measurement");
  }

  void set_external_wrench(int link, const arm::GivenWrench& wrench) {
    if constexpr (Scene::external_wrench) {
      wrenches[link] = wrench;
      machine.set_external_wrench(link, arm::in_core_axes<Scene>(link, wrench));
    }
  }
  void clear_external_wrenches() {
    for (int link = 0; link < Scene::L; ++link) set_external_wrench(link, {});
  }
  int check_wrench_link(int link) const {
    if (!Scene::external_wrench) return refuse(-1, "external_wrench", "be true in the scene", 0.0);
    if (link < 0 || link >= Scene::L) return refuse(-1, "link", "be one that moves", link);
    return ARM_OK;
  }

  std::int64_t tick() const { return machine.steps() / steps_per_period; }
  int result() const { return machine.faulty_joint() < 0 ? ARM_OK : ARM_DIVERGED; }

  static std::int64_t read_clock() {
#ifdef __CUDA__
    return 0;  // machines on a card measure no time
#else
    timespec t{};
    clock_gettime(CLOCK_MONOTONIC, &t);
    return t.tv_sec * 1'000'000'000LL + t.tv_nsec;
#endif
  }

  // Whether something measures at every tick.
  static constexpr bool has_sampled_sensors =
      arm::Sensors<Scene>::present || arm::IoLinks<Scene>::present;

  // Take `steps` steps by calls of advance(count); sensors measure at every tick.
  template <class Advance>
  void advance_with_sensors(std::int64_t steps, Advance&& advance) {
    const std::int64_t start_ns = measures_time ? read_clock() : 0;
    advance_between_ticks(steps, advance);
    if (measures_time) spent_ns += read_clock() - start_ns;
  }
  template <class Advance>
  void advance_between_ticks(std::int64_t steps, Advance& advance) {
    if constexpr (!has_sampled_sensors) {
      advance(steps);
    } else {
      while (steps > 0 && machine.faulty_joint() < 0) {
        const std::int64_t due = steps_per_period - machine.steps() % steps_per_period;
        const std::int64_t chunk = steps < due ? steps : due;
        advance(chunk);
        sample_sensors();
        steps -= chunk;
      }
    }
  }
  // A row of joints to one of drives, of which the others stay as they are, and back.
  template <class Number, class To>
  static void copy_to_drives(const Number* row, To* drives) {
    for (int j = 0; j < J; ++j) drives[arm::drive_of<Scene>(j)] = row[j];
  }
  template <class Number, class To>
  static void copy_to_joints(const Number* drives, To* row) {
    for (int j = 0; j < J; ++j) row[j] = drives[arm::drive_of<Scene>(j)];
  }
  using Drives = arm::DriveRow<Scene, double>;
  // Commands applied to the motors: 0 without power.
  Drives apply_power(const double* command) const {
    static constexpr double nothing[J] = {};
    return Drives(powered ? command : nothing);
  }
  // Follow rows of commands; q after each goes to `q`.
  void follow_commands(const double* command, std::int64_t rows, std::int64_t steps, double* q) {
    if (!has_sampled_sensors && powered && J == N) {
      machine.follow_commands(command, rows, steps, q);
    } else {
      for (; rows > 0; --rows, command += J, q += J) {
        const Drives applied = apply_power(command);
        advance_with_sensors(steps,
                             [&](std::int64_t chunk) { machine.advance(applied.of, chunk); });
        copy_to_joints(machine.state().q, q);
      }
    }
  }
  // To be called after steps, at the next tick at the latest. A diverged machine is back at an
  // earlier state.
  void sample_sensors() {
    if (machine.faulty_joint() >= 0) return restart_sensors(false);
    sensors.measure(machine, tick());
    if constexpr (IoLinks::present)
      if (tick() != io_links.newest_tick())
        measure_into(
            [&](arm_measurement& all) { io_links.transmit_measurement(machine, tick(), all); });
  }
  // Measure as if the machine had always rested where it is; `resets`: with nothing from before.
  void restart_sensors(bool resets) {
    sensors.restart(machine, tick(), resets);
    if constexpr (IoLinks::present)
      measure_into([&](arm_measurement& all) { io_links.restart(tick(), all); });
  }

  // ARM_OK if a drive takes each of these; of `further` only that of a drive that is enabled
  // counts.
  int check_commands(const arm_joint_command* joint, const double* further) const {
    for (int j = 0; j < J; ++j) {
      const int drive = arm::drive_of<Scene>(j);
      if (!joint[j].enable) continue;
      if (joint[j].mode != arm::kModes.at[drive])
        return refuse(j, "mode", "be one that the drive has", joint[j].mode);
      if (!arm::is_finite(joint[j].value)) return refuse(j, "command", "be finite", joint[j].value);
      for (int r = 0; further && r < Scene::inputs; ++r) {
        const double value = further[r * J + j];
        const char* name = Scene::input[r].name;
        if (!arm::is_finite(value)) return refuse(j, name, "be finite", value);
        if (Scene::input[r].of[drive] < 0 && value != 0.0)
          return refuse(j, name, "be 0, its motor has no such input", value);
      }
    }
    return ARM_OK;
  }
  // Hold them for the period that begins, in `applied` what the motors get. `is_received`: they are
  // those that the drives received.
  void apply_commands(const arm_joint_command* joint, const double* further, std::int64_t tick,
                      bool is_received = false) {
    if constexpr (IoLinks::present) {
      arm_joint_command received[J];
      double rows[Scene::inputs * J + 1] = {};
      for (int j = 0; j < J; ++j) received[j] = joint[j];
      for (int k = 0; further && k < Scene::inputs * J; ++k) rows[k] = further[k];
      io_links.transmit_commands(machine, this->tick(), is_received, received, rows);
      set_commands(received, rows, tick);
    } else {
      set_commands(joint, further, tick);
    }
    machine.clamp_commands(applied);
  }
  // Hold commands without bounding them.
  void set_commands(const arm_joint_command* joint, const double* further, std::int64_t tick) {
    double rows[Scene::inputs * N + 1] = {};
    bool hot[N] = {};  // a motor that is too hot is not enabled
    if constexpr (Machine::has_winding_temperature) machine.find_overheated(hot);
    for (int j = 0; j < J; ++j) {
      const int drive = arm::drive_of<Scene>(j);
      const bool on = powered && joint[j].enable && !hot[drive];
      applied[drive] = on ? joint[j].value : 0.0;
      for (int r = 0; r < Scene::inputs; ++r)
        rows[r * N + drive] = on && further ? further[r * J + j] : 0.0;
    }
    for (int k = 0; k < Scene::brakes; ++k) {
      machine.request_brake(k, is_brake_commanded(k, joint, hot));
    }
    if constexpr (Scene::inputs > 0) machine.set_further_inputs(rows);
    answered = tick;
  }
  // Whether brake k is wanted closed under these commands.
  bool is_brake_commanded(int k, const arm_joint_command* joint, const bool* hot) const {
    const int j = Scene::braked[k];
    const std::uint32_t enable = hot && hot[arm::drive_of<Scene>(j)] ? 0 : joint[j].enable;
    return !powered || !enable || enable & ARM_CLOSE_BRAKE;
  }

  // Inputs of a measurement beside the sensors' memories.
  struct Motors {
    double current[N], angle[N], speed[N];
    std::int64_t steps;
  };
  void measure(arm_measurement* out) const {
    Motors motors;
    motors.steps = machine.steps();
    machine.get_motor_signals(motors.current, motors.angle, motors.speed);
    measure(out, motors);
  }
  void measure(arm_measurement* out, const Motors& motors) const {
    measure_machine(out, motors);
    if constexpr (IoLinks::present) {
      arm_measurement all = *out;
      if (!has_field(out, offsetof(arm_measurement, readings)))
        all.sensors = nullptr, all.current_d = nullptr;
      if (!has_field(out, offsetof(arm_measurement, further))) all.readings = nullptr;
      io_links.write_received(all);
    }
  }
  // Measure everything on this side of the lines, for use(measurement).
  template <class Use>
  void measure_into(Use&& use) const {
    arm_joint_measurement joint[J];
    arm_joint_sensors own[J] = {};
    double current_d[J] = {}, readings[Scene::readings * J + 1], further[Scene::inputs * J + 1];
    arm_measurement all = {};
    all.size = sizeof all;
    all.joint = joint, all.sensors = own, all.current_d = current_d;
    all.readings = readings, all.further = further;
    Motors motors;
    motors.steps = machine.steps();
    machine.get_motor_signals(motors.current, motors.angle, motors.speed);
    measure_machine(&all, motors);
    use(all);
  }
  // Counts of an ideal encoder at motor j.
  static std::int64_t counts(int j, double angle) {
    const double counts = __builtin_floor(angle * Scene::device[j].counts_per_rad + arm::kOnAnEdge);
    return static_cast<std::int64_t>(arm::clamp(counts, 0x1p62));
  }
  // Counts of ideal encoders in lanes.
  template <class X>
  static auto counts(int j, const X& angle) {
    X counts = angle * Scene::device[j].counts_per_rad + arm::kOnAnEdge;
    for (int lane = 0; lane < arm::kWidth<X>; ++lane) counts[lane] = __builtin_floor(counts[lane]);
    return __builtin_convertvector(arm::clamp(counts, 0x1p62), arm::Mask<X>);
  }
  void measure_machine(arm_measurement* out, const Motors& motors) const {
    [[maybe_unused]] bool hot[N] = {};
    if constexpr (Machine::has_winding_temperature) machine.find_overheated(hot);
    const int faulty = faulty_joint();
    for (int j = 0; j < J; ++j) {
      const int drive = arm::drive_of<Scene>(j);
      arm_joint_measurement& joint = out->joint[j];
      joint.encoder = counts(drive, motors.angle[drive]);
      joint.current = motors.current[drive];
      joint.applied = applied[drive];
      joint.faults = faulty == j ? std::uint32_t{ARM_FAULT_DIVERGED} : 0;
      if constexpr (Machine::has_winding_temperature)
        if (hot[drive]) joint.faults |= ARM_FAULT_THERMAL;
      joint.brake = 0;
    }
    for (int k = 0; k < Scene::brakes; ++k)
      out->joint[Scene::braked[k]].brake = machine.is_brake_closed(k);
    out->powered = powered != 0;
    out->tick = motors.steps / steps_per_period;
    out->answered = answered;
    const bool more = has_field(out, offsetof(arm_measurement, readings));
    if (more && out->current_d) {
      double of_drives[N];
      machine.currents_d(of_drives);
      copy_to_joints(of_drives, out->current_d);
    }
    if constexpr (Scene::inputs > 0)
      if (has_field(out, sizeof *out) && out->further) {
        double of_drives[Scene::inputs * N + 1];  // a scene may have no further inputs
        machine.applied_inputs(of_drives);
        for (int r = 0; r < Scene::inputs; ++r)
          copy_to_joints(of_drives + r * N, out->further + r * J);
      }
    double* readings = has_field(out, offsetof(arm_measurement, further)) ? out->readings : nullptr;
    write_deflections(readings, [&](int drive) { return motors.angle[drive]; });
    const Places places = {out->joint, more ? out->sensors : nullptr, more ? out->imu : nullptr,
                           readings ? readings + arm::count_deflections<Scene>() * J : nullptr};
    measure_by(sensors, places);
  }
  // Fill the rows of deflections among the readings, if the scene has them, by position(drive). The
  // position is the angle of a deflection's missing motor.
  template <class Position>
  static void write_deflections(double* readings, Position&& position) {
    for (int row = 0; readings && row < arm::count_deflections<Scene>(); ++row)
      for (int j = 0; j < J; ++j) {
        const int drive = arm::find_deflection<Scene>(row, j);
        readings[row * J + j] = drive < 0 ? 0.0 : position(drive);
      }
  }
  // The joint that diverged, or in whose bearing a deflection did; -1: none.
  int faulty_joint() const { return arm::find_joint<Scene>(machine.faulty_joint()); }
  static bool has_field(const arm_measurement* out, std::size_t size) { return out->size >= size; }

  // Destination of readings; all but the first may be null.
  struct Places {
    arm_joint_measurement* joint;
    arm_joint_sensors* sensors;
    arm_imu_measurement* units;
    double* readings;
  };
  // Replace ideal values by the sensors' readings.
  template <class TheSensors>
  static void measure_by(const TheSensors& sensors, const Places& to) {
    for (int j = 0; to.sensors && j < J; ++j) to.sensors[j] = {};
    if constexpr (TheSensors::present) {
      for (int j = 0; j < J; ++j) {
        const int drive = arm::drive_of<Scene>(j);
        const arm::EncoderReading &motor = sensors.encoder(drive),
                                  &link = sensors.link_encoder(drive);
        to.joint[j].encoder = motor.counts;
        if (to.sensors)
          to.sensors[j] = {motor.index, motor.pulses, link.counts, link.index, link.pulses, 0.0};
      }
      double* readings = to.readings;
      sensors.for_each_analog([&](auto quantity, auto&& reading) {
        constexpr arm::Field field = decltype(quantity)::field;
        for (int j = 0; j < J; ++j) {
          const int drive = arm::drive_of<Scene>(j);
          if constexpr (field == arm::Field::current) {
            to.joint[j].current = reading(drive);
          } else if constexpr (field == arm::Field::torque) {
            if (to.sensors) to.sensors[j].torque = reading(drive);
          } else if (readings) {
            *readings++ = reading(drive);
          }
        }
      });
      for (int m = 0; to.units && m < sensors.M; ++m)
        for (int k = 0; k < 3; ++k) {
          to.units[m].specific_force[k] = sensors.imu(m).specific_force[k];
          to.units[m].angular_rate[k] = sensors.imu(m).angular_rate[k];
        }
    }
  }
  template <class TheSensors>
  static void describe([[maybe_unused]] int j, [[maybe_unused]] arm_joint_description& joint) {
    if constexpr (TheSensors::present) {
      const arm::Encoder &motor = TheSensors::structure.encoder[j],
                         &link = TheSensors::structure.link_encoder[j];
      joint.encoder_wrap = motor.wrap();
      joint.link_encoder_wrap = link.wrap();
      if (motor.index != arm::Index::none) joint.sensors |= ARM_HAS_INDEX;
      if (link.kind != arm::EncoderKind::none) {
        joint.link_counts_per_rad = link.counts_per_rad;
        joint.sensors |= ARM_HAS_LINK_ENCODER;
      }
      if (link.index != arm::Index::none) joint.sensors |= ARM_HAS_LINK_INDEX;
      if (arm::has_sensor<Scene>(j, arm::Field::torque)) joint.sensors |= ARM_HAS_TORQUE;
    }
  }

  using Sensors = arm::Sensors<Scene>;
  using IoLinks = arm::IoLinks<Scene>;
  Machine machine;
  [[no_unique_address]] Sensors sensors;
  [[no_unique_address]] IoLinks io_links;
  double step;
  std::int64_t steps_per_period;
  std::int64_t answered = -1;  // tick that the newest command answered
  double applied[N] = {};      // in the period that has passed
  std::int64_t powered = true;
  bool measures_time = false;
  std::int64_t spent_ns = 0;  // wall time of steps, while it is measured
  arm::GivenWrench wrenches[Scene::external_wrench ? Scene::L : 1] = {};
  void (*listener)(void*, const arm_machine*) = nullptr;  // called at the end of every exchange
  void* listens_with = nullptr;
  mutable arm_refusal why = {sizeof(arm_refusal), -1, "", "", 0.0};
};

namespace {

// Write the fields of a struct that its user's version of arm.h has.
template <class Struct>
int copy_fields(Struct* out, const Struct& all) {
  __builtin_memcpy(out, &all, out->size < sizeof all ? out->size : sizeof all);
  return ARM_OK;
}

}  // namespace
