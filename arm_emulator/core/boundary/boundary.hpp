// The functions of arm.h for one scene's machine. Included last in a scene's unit, after its
// `struct Scene`.
#pragma once

#include <time.h>

#include <array>
#include <cstddef>

#include "arm.h"
#include "machine/machine.hpp"
#include "mechanics/linearisation.hpp"
#include "mechanics/sensors.hpp"

// Digest of the sources of a scene's library; set on the compiler's command line (compiler.py).
#ifndef ARM_FINGERPRINT
#define ARM_FINGERPRINT 0
#endif

namespace arm {

// Texts of a refusal are cut to the room.
template <int room>
void write_text(char (&to)[room], const char* text) {
  int length = 0;
  for (; text[length] && length < room - 1; ++length) to[length] = text[length];
  to[length] = 0;
}

// The enum arm_mode of each joint's commands.
struct CommandModes {
  std::int32_t at[Scene::N] = {};
  constexpr CommandModes() {
    for_each_drive<Scene>(
        [&](const auto& drive, int j) { at[j] = static_cast<std::int32_t>(drive.motor.takes); });
  }
};
inline constexpr CommandModes kModes;

// Whether joint j has a sensor of a field, of the readings that of a row.
template <class S>
bool senses([[maybe_unused]] int j, [[maybe_unused]] Field field, [[maybe_unused]] int row = 0) {
  bool found = false;
  if constexpr (Sensors<S>::present)
    std::apply(
        [&]<class... Rows>(const Rows&... rows) {
          ((found |= Rows::Quantity::field == field && row-- == 0 && rows.at[j].present), ...);
        },
        Sensors<S>::structure.analog);
  return found;
}

template <class S>
int describe_reading(int reading, int joint, arm_reading* out) {
  if constexpr (S::readings > 0) {
    const Reading& one = S::reading[reading];
    const bool slides = kind_of<S>(joint) != JointKind::revolute;
    out->present = senses<S>(joint, Field::reading, reading);
    out->name = one.name, out->unit = slides ? one.unit_of_slides : one.unit;
  }
  return ARM_OK;
}

}  // namespace arm

struct arm_machine {
  using Machine = arm::Machine<Scene>;
  static constexpr int N = Scene::N;

  // Of the varied numbers and the brakes, and one that is 0.
  using Values = double[arm::kOwnNumbers<Scene> + 1];

  // Saved numbers, eight bytes each in a fixed order: a digest of the library, then the machine.
  template <class Number>
  static void for_each_saved_number(arm_machine& one, Machine::Whole& whole, Values& values,
                                    Number&& number) {
    number(one.step);
    number(one.steps_per_period);
    whole.for_each_number(number);
    one.sensors.for_each_number(number);
    number(one.answered);
    for (double& value : one.applied) number(value);
    number(one.powered);
    for (double& value : values) number(value);
    if constexpr (Scene::external_wrench)
      for (arm::GivenWrench& wrench : one.given)
        for (double& entry : wrench.numbers) number(entry);
  }

  explicit arm_machine(const arm_options& options)
      : machine(options.step, options.core, options.parameters),
        step(options.step),
        steps_per_period(options.steps_per_period) {}

  int refuse(int joint, const char* quantity, const char* rule, double got) const {
    why.joint = joint;
    arm::write_text(why.quantity, quantity);
    arm::write_text(why.rule, rule);
    why.got = got;
    return ARM_REFUSED;
  }
  // ARM_OK unless a required pointer is null.
  int check_there(const void* pointer, const char* quantity) const {
    return pointer ? ARM_OK : refuse(-1, quantity, "be there, no null pointer", 0.0);
  }
  int check_count(std::int64_t count, const char* quantity) const {
    return count >= 0 ? ARM_OK : refuse(-1, quantity, "be at least 0", static_cast<double>(count));
  }
  // ARM_OK if all numbers of a row are finite.
  int check_finite(const double* row, const char* quantity) const {
    if (check_there(row, quantity)) return ARM_REFUSED;
    for (int j = 0; j < N; ++j)
      if (!arm::is_finite(row[j])) return refuse(j, quantity, "be finite", row[j]);
    return ARM_OK;
  }
  // A struct may be as short as it was in version 1 of arm.h.
  template <class Struct>
  int check_size(const Struct* one, std::size_t least = sizeof(Struct)) const {
    if (check_there(one, "struct")) return ARM_REFUSED;
    if (one->size >= least) return ARM_OK;
    return refuse(-1, "size", "be that of the struct in arm.h", one->size);
  }

  int check_measurement(const arm_measurement* out) const {
    if (check_size(out, offsetof(arm_measurement, sensors))) return ARM_REFUSED;
    return check_there(out->joint, "joint of the measurement");
  }

  void set_external_wrench(int j, const arm::GivenWrench& wrench) {
    if constexpr (Scene::external_wrench) {
      given[j] = wrench;
      machine.set_external_wrench(j, arm::in_core_axes<Scene>(j, wrench));
    }
  }
  void forget_external_wrenches() {
    for (int j = 0; j < N; ++j) set_external_wrench(j, {});
  }
  int refuse_wrench(int joint) const {
    if (!Scene::external_wrench) return refuse(-1, "external_wrench", "be true in the scene", 0.0);
    if (joint < 0 || joint >= N) return refuse(-1, "joint", "be one of the scene", joint);
    return ARM_OK;
  }

  std::int64_t tick() const { return machine.steps() / steps_per_period; }
  int result() const { return machine.faulty_joint() < 0 ? ARM_OK : ARM_DIVERGED; }

  static std::int64_t now_ns() {
    timespec t{};
    clock_gettime(CLOCK_MONOTONIC, &t);
    return t.tv_sec * 1'000'000'000LL + t.tv_nsec;
  }

  // Take `steps` steps by calls of advance(count); sensors measure at every tick.
  template <class Advance>
  void go(std::int64_t steps, Advance&& advance) {
    const std::int64_t began = measures_time ? now_ns() : 0;
    take_steps(steps, advance);
    if (measures_time) spent_ns += now_ns() - began;
  }
  template <class Advance>
  void take_steps(std::int64_t steps, Advance& advance) {
    if constexpr (!Sensors::present) {
      advance(steps);
    } else {
      while (steps > 0 && machine.faulty_joint() < 0) {
        const std::int64_t due = steps_per_period - machine.steps() % steps_per_period;
        const std::int64_t some = steps < due ? steps : due;
        advance(some);
        look();
        steps -= some;
      }
    }
  }
  // Commands applied to the motors: 0 without power.
  const double* with_power(const double* command) const {
    static constexpr double nothing[N] = {};
    return powered ? command : nothing;
  }
  // The same for rows of commands; q after each goes to `q`.
  void follow(const double* command, std::int64_t rows, std::int64_t steps, double* q) {
    if (!Sensors::present && powered) {
      machine.follow(command, rows, steps, q);
    } else {
      for (; rows > 0; --rows, command += N, q += N) {
        go(steps, [&](std::int64_t some) { machine.advance(with_power(command), some); });
        for (int j = 0; j < N; ++j) q[j] = machine.state().q[j];
      }
    }
  }
  // To be called after steps, at the next tick at the latest. A diverged machine is back at an
  // earlier state.
  void look() {
    if (machine.faulty_joint() < 0)
      sensors.look(machine, tick());
    else
      sensors.begin(machine, tick(), false);
  }

  // ARM_OK if a drive takes each of these; of `further` only that of a drive that is enabled
  // counts.
  int check_commands(const arm_joint_command* joint, const double* further) const {
    for (int j = 0; j < N; ++j) {
      if (!joint[j].enable) continue;
      if (joint[j].mode != arm::kModes.at[j])
        return refuse(j, "mode", "be one that the drive has", joint[j].mode);
      if (!arm::is_finite(joint[j].value)) return refuse(j, "value", "be finite", joint[j].value);
      for (int r = 0; further && r < Scene::inputs; ++r) {
        const double value = further[r * N + j];
        const char* name = Scene::input[r].name;
        if (!arm::is_finite(value)) return refuse(j, name, "be finite", value);
        if (Scene::input[r].of[j] < 0 && value != 0.0)
          return refuse(j, name, "be 0, its motor has no such input", value);
      }
    }
    return ARM_OK;
  }
  // Hold them for the period that begins, in `applied` what the motors get.
  void take_commands(const arm_joint_command* joint, const double* further, std::int64_t tick) {
    put_commands(joint, further, tick);
    machine.bound(applied);
  }
  // The same, except for their bounds.
  void put_commands(const arm_joint_command* joint, const double* further, std::int64_t tick) {
    double rows[Scene::inputs * N + 1] = {};
    bool hot[N] = {};  // a motor that is too hot is not enabled
    if constexpr (Machine::heats) machine.too_hot(hot);
    for (int j = 0; j < N; ++j) {
      const bool on = powered && joint[j].enable && !hot[j];
      applied[j] = on ? joint[j].value : 0.0;
      for (int r = 0; r < Scene::inputs; ++r)
        rows[r * N + j] = on && further ? further[r * N + j] : 0.0;
    }
    for (int k = 0; k < Scene::brakes; ++k) {
      machine.want_brake(k, closes_brake(k, joint, hot));
    }
    if constexpr (Scene::inputs > 0) machine.put_further(rows);
    answered = tick;
  }
  // Whether brake k is wanted closed under these commands.
  bool closes_brake(int k, const arm_joint_command* joint, const bool* hot) const {
    const int j = Scene::braked[k];
    const std::uint32_t enable = hot && hot[j] ? 0 : joint[j].enable;
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
    machine.report(motors.current, motors.angle, motors.speed);
    measure(out, motors);
  }
  void measure(arm_measurement* out, const Motors& motors) const {
    [[maybe_unused]] bool hot[N] = {};
    if constexpr (Machine::heats) machine.too_hot(hot);
    for (int j = 0; j < N; ++j) {
      arm_joint_measurement& joint = out->joint[j];
      const double counts = __builtin_floor(motors.angle[j] * Scene::device[j].counts_per_rad);
      joint.encoder = static_cast<std::int64_t>(arm::clamp(counts, 0x1p62));
      joint.current = motors.current[j];
      joint.applied = applied[j];
      joint.faults = machine.faulty_joint() == j ? std::uint32_t{ARM_FAULT_DIVERGED} : 0;
      if constexpr (Machine::heats)
        if (hot[j]) joint.faults |= ARM_FAULT_THERMAL;
      joint.brake = 0;
    }
    for (int k = 0; k < Scene::brakes; ++k)
      out->joint[Scene::braked[k]].brake = machine.brake_closed(k);
    out->powered = powered != 0;
    out->tick = motors.steps / steps_per_period;
    out->answered = answered;
    const bool more = has(out, offsetof(arm_measurement, readings));
    if (more && out->current_d) machine.currents_d(out->current_d);
    if constexpr (Scene::inputs > 0)
      if (has(out, sizeof *out) && out->further) machine.further_got(out->further);
    const Places places = {out->joint, more ? out->sensors : nullptr, more ? out->imu : nullptr,
                           has(out, offsetof(arm_measurement, further)) ? out->readings : nullptr};
    measure_by(sensors, places);
  }
  static bool has(const arm_measurement* out, std::size_t size) { return out->size >= size; }

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
    for (int j = 0; to.sensors && j < N; ++j) to.sensors[j] = {};
    if constexpr (TheSensors::present) {
      for (int j = 0; j < N; ++j) {
        const arm::EncoderReading &motor = sensors.encoder(j), &link = sensors.link_encoder(j);
        to.joint[j].encoder = motor.counts;
        if (to.sensors)
          to.sensors[j] = {motor.index, motor.pulses, link.counts, link.index, link.pulses, 0.0};
      }
      double* readings = to.readings;
      sensors.for_each_analog([&](auto quantity, auto&& reading) {
        constexpr arm::Field field = decltype(quantity)::field;
        for (int j = 0; j < N; ++j) {
          if constexpr (field == arm::Field::current) {
            to.joint[j].current = reading(j);
          } else if constexpr (field == arm::Field::torque) {
            if (to.sensors) to.sensors[j].torque = reading(j);
          } else if (readings) {
            *readings++ = reading(j);
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
      if (arm::senses<Scene>(j, arm::Field::torque)) joint.sensors |= ARM_HAS_TORQUE;
    }
  }

  using Sensors = arm::Sensors<Scene>;
  Machine machine;
  [[no_unique_address]] Sensors sensors;
  double step;
  std::int64_t steps_per_period;
  std::int64_t answered = -1;  // tick that the newest command answered
  double applied[N] = {};      // in the period that has passed
  std::int64_t powered = true;
  bool measures_time = false;
  std::int64_t spent_ns = 0;  // wall time of steps, while it is measured
  arm::GivenWrench given[Scene::external_wrench ? N : 1] = {};
  void (*listener)(void*, const arm_machine*) = nullptr;  // called at the end of every exchange
  void* listens_with = nullptr;
  mutable arm_refusal why = {sizeof(arm_refusal), -1, "", "", 0.0};
};

namespace {

// Write the fields of a struct that its user's version of arm.h has.
template <class Struct>
int fill(Struct* out, const Struct& all) {
  __builtin_memcpy(out, &all, out->size < sizeof all ? out->size : sizeof all);
  return ARM_OK;
}

}  // namespace

#pragma GCC visibility push(default)

// Periods of the scene. No code depends on them, and scenes that differ in them alone share a
// library: the numbers are written into a copy for use outside of the cache (compiler.py).
extern "C" {
struct arm_periods {
  double servo_period, step;
  std::int64_t steps_per_period;
};
__attribute__((visibility("protected"))) volatile arm_periods arm_scene_periods = {
    -1.0, -1.0, -1};  // in the file, as no zeros would be
}

int arm_describe(arm_description* out) {
  if (!out || out->size < offsetof(arm_description, imus)) return ARM_REFUSED;
  arm_description all = {};
  all.size = out->size;
  all.version = ARM_VERSION;
  all.joints = arm_machine::N;
  all.parameters = Scene::parameters;
  all.fingerprint = ARM_FINGERPRINT;
  all.supply_voltage = Scene::supply_voltage;
  all.imus = arm_machine::Sensors::M;
  all.readings = Scene::readings;
  all.inputs = Scene::inputs;
  if (arm_scene_periods.steps_per_period > 0) {
    all.servo_period = arm_scene_periods.servo_period;
    all.step = arm_scene_periods.step;
    all.steps_per_period = arm_scene_periods.steps_per_period;
  }
  return fill(out, all);
}

int arm_describe_joint(std::int32_t joint, arm_joint_description* out) {
  if (!out || out->size < offsetof(arm_joint_description, encoder_wrap) || joint < 0 ||
      joint >= arm_machine::N)
    return ARM_REFUSED;
  arm_joint_description all = {};
  all.size = out->size;
  all.name = Scene::device[joint].name;
  all.kind = arm::kind_of<Scene>(joint) == arm::JointKind::revolute ? ARM_REVOLUTE : ARM_PRISMATIC;
  all.counts_per_rad = Scene::device[joint].counts_per_rad;
  arm::for_each_drive<Scene>([&](const auto& drive, int j) {
    if (j != joint) return;
    all.modes = drive.driven ? arm::kModes.at[j] : 0;
    all.gear_ratio = drive.gear.Ng;
    all.current_limit = drive.motor.largest_current();
  });
  arm_machine::describe<arm_machine::Sensors>(joint, all);
  return fill(out, all);
}

int arm_describe_reading(std::int32_t reading, std::int32_t joint, arm_reading* out) {
  if (!out || out->size < sizeof *out || reading < 0 || reading >= Scene::readings || joint < 0 ||
      joint >= arm_machine::N)
    return ARM_REFUSED;
  return arm::describe_reading<Scene>(reading, joint, out);
}

int arm_describe_input(std::int32_t input, std::int32_t joint, arm_reading* out) {
  if (!out || out->size < sizeof *out || input < 0 || input >= Scene::inputs || joint < 0 ||
      joint >= arm_machine::N)
    return ARM_REFUSED;
  const arm::FurtherInput<arm_machine::N>& row = Scene::input[input];
  *out = {out->size, row.of[joint] >= 0, row.name, row.unit[joint]};
  return ARM_OK;
}

namespace {

bool within_bounds(int k, double value) {
  const arm::Parameter& one = Scene::parameter[k];
  return arm::is_finite(value) && value >= one.least && value <= one.most;
}

}  // namespace

ARM_ONCE arm_machine* arm_new(const arm_options* options) {
  bool sound = options && options->size >= sizeof *options && options->core >= -1 &&
               arm::is_finite(options->step) && options->step > 0.0 &&
               options->steps_per_period > 0 && (options->parameters || !Scene::parameters);
  for (int k = 0; sound && k < Scene::parameters; ++k)
    sound = within_bounds(k, options->parameters[k]);
  if (!sound) return nullptr;
  arm_machine* machine = new arm_machine(*options);
  const double zero[arm_machine::N] = {};
  machine->machine.reset(zero, zero);
  machine->sensors.begin(machine->machine, 0, true);
  return machine;
}
void arm_delete(arm_machine* machine) { delete machine; }

int arm_reset(arm_machine* machine, const double* q, const double* v) {
  if (!machine || machine->check_finite(q, "q") || machine->check_finite(v, "v"))
    return ARM_REFUSED;
  machine->forget_external_wrenches();
  machine->machine.put_brakes(!machine->powered);
  machine->machine.reset(q, v);
  machine->sensors.begin(machine->machine, 0, true);
  machine->answered = -1;
  for (double& one : machine->applied) one = 0.0;
  return ARM_OK;
}

int arm_join_schedule(arm_machine* machine) {
  return machine ? machine->machine.join_schedule() : 0;
}

void arm_begin_threads(arm_machine* machine) {
  if (machine) machine->machine.begin_thread();
}

int arm_exchange(arm_machine* machine, const arm_command* command, arm_measurement* out) {
  if (!machine || machine->check_size(command, offsetof(arm_command, further)) ||
      machine->check_there(command->joint, "joint of the command") ||
      machine->check_measurement(out))
    return ARM_REFUSED;
  const double* further = command->size >= sizeof *command ? command->further : nullptr;
  if (machine->check_commands(command->joint, further)) return ARM_REFUSED;
  machine->take_commands(command->joint, further, command->tick);
  machine->go(machine->steps_per_period,
              [&](std::int64_t steps) { machine->machine.advance(machine->applied, steps); });
  machine->measure(out);
  if (machine->listener) machine->listener(machine->listens_with, machine);
  return machine->result();
}

ARM_ONCE void arm_listen(arm_machine* machine, void (*listener)(void*, const arm_machine*),
                         void* with) {
  if (!machine) return;
  machine->listener = listener;
  machine->listens_with = with;
}

int arm_measure(const arm_machine* machine, arm_measurement* out) {
  if (!machine || machine->check_measurement(out)) return ARM_REFUSED;
  machine->measure(out);
  return machine->result();
}

void arm_power(arm_machine* machine, int on) {
  if (!machine || machine->powered == (on != 0)) return;
  machine->powered = on != 0;
  for (int k = 0; k < Scene::brakes; ++k) machine->machine.want_brake(k, !machine->powered);
  if constexpr (Scene::inputs > 0) {
    static constexpr std::array<double, Scene::inputs * arm_machine::N> nothing{};
    if (!on) machine->machine.put_further(nothing.data());
  }
}

int arm_why(const arm_machine* machine, arm_refusal* out) {
  if (!machine || !out || out->size < sizeof *out) return ARM_REFUSED;
  *out = machine->why;
  return ARM_OK;
}

namespace {

// The place of a varied number in the list; -1: none of that name.
int place_of(const char* name) {
  for (int k = 0; name && k < Scene::parameters; ++k)
    if (__builtin_strcmp(Scene::parameter[k].name, name) == 0) return k;
  return -1;
}

}  // namespace

int arm_describe_parameter(std::int32_t index, arm_parameter* out) {
  if (!out || out->size < sizeof *out || index < 0 || index >= Scene::parameters)
    return ARM_REFUSED;
  const arm::Parameter& one = Scene::parameter[index];
  *out = {out->size, 0, one.name, one.least, one.most};
  return ARM_OK;
}

int arm_get_parameter(const arm_machine* machine, const char* name, double* value) {
  if (!machine || machine->check_there(value, "value")) return ARM_REFUSED;
  const int k = place_of(name);
  if (k < 0) return machine->refuse(-1, "parameter", "be varied in this scene", 0.0);
  *value = machine->machine.parameter(k);
  return ARM_OK;
}

int arm_set_parameter(arm_machine* machine, const char* name, double value) {
  if (!machine) return ARM_REFUSED;
  const int k = place_of(name);
  if (k < 0) return machine->refuse(-1, "parameter", "be varied in this scene", 0.0);
  if (!within_bounds(k, value))
    return machine->refuse(-1, "parameter", "be within its bounds", value);
  machine->machine.set_parameter(k, value);
  return ARM_OK;
}

namespace {

int check_wrench(const arm_machine* machine, std::int32_t joint, const arm_wrench* wrench,
                 arm::GivenWrench& given) {
  if (machine->refuse_wrench(joint) || machine->check_size(wrench)) return ARM_REFUSED;
  if (wrench->axes != ARM_LINK_AXES && wrench->axes != ARM_WORLD_AXES)
    return machine->refuse(joint, "axes", "be one of enum arm_axes", wrench->axes);
  double* to = given.numbers;
  for (const auto& vector : {wrench->point, wrench->force, wrench->moment})
    for (int k = 0; k < 3; ++k) {
      if (!arm::is_finite(vector[k]) || arm::magnitude(vector[k]) > ARM_LARGEST_WRENCH)
        return machine->refuse(joint, "external wrench", "be finite and at most 1e9", vector[k]);
      *to++ = vector[k];
    }
  *to = wrench->axes == ARM_WORLD_AXES;
  return ARM_OK;
}

}  // namespace

int arm_set_external_wrench(arm_machine* machine, std::int32_t joint, const arm_wrench* wrench) {
  arm::GivenWrench given = {};
  if (!machine || check_wrench(machine, joint, wrench, given)) return ARM_REFUSED;
  machine->set_external_wrench(joint, given);
  return ARM_OK;
}

int arm_get_external_wrench(const arm_machine* machine, std::int32_t joint, arm_wrench* out) {
  if (!machine || machine->refuse_wrench(joint) || machine->check_size(out)) return ARM_REFUSED;
  const double* of = machine->given[Scene::external_wrench ? joint : 0].numbers;
  for (double* vector : {out->point, out->force, out->moment})
    for (int k = 0; k < 3; ++k) vector[k] = *of++;
  out->axes = *of != 0.0 ? ARM_WORLD_AXES : ARM_LINK_AXES;
  return ARM_OK;
}

namespace {

constexpr std::int64_t kWord = 8;

// Reader or writer of the words of a saved machine. They end with a checksum, which detects
// spoiled bytes.
struct Words {
  unsigned char* at;
  std::uint64_t sum = 0xcbf29ce484222325;

  template <class Number>
  void write(const Number& number) {
    static_assert(sizeof number == kWord);
    __builtin_memcpy(at, &number, kWord);
    pass();
  }
  template <class Number>
  void read(Number& number) {
    static_assert(sizeof number == kWord);
    __builtin_memcpy(&number, at, kWord);
    pass();
  }
  ARM_ONCE void pass() {
    std::uint64_t word;
    __builtin_memcpy(&word, at, kWord);
    sum = (sum ^ word) * 0x100000001b3;  // FNV-1a: a change of any one word changes the sum
    sum ^= sum >> 32;
    at += kWord;
  }
};

}  // namespace

ARM_ONCE std::int64_t arm_saved_size(void) {
  static const std::int64_t size = [] {
    const arm::SomeValues<Scene> some;
    arm_machine none({sizeof(arm_options), -1, 1.0, 1, some.p});
    arm_machine::Machine::Whole whole = {};
    arm_machine::Values values = {};
    std::int64_t words = 2;  // the fingerprint, the sum
    arm_machine::for_each_saved_number(none, whole, values, [&](const auto&) { ++words; });
    return words * kWord;
  }();
  return size;
}

ARM_ONCE void arm_measure_time(arm_machine* machine) {
  if (machine) machine->measures_time = true;
}

ARM_ONCE std::int64_t arm_spent(const arm_machine* machine) {
  return machine ? machine->spent_ns : 0;
}

ARM_ONCE int arm_save(const arm_machine* machine, void* out, std::int64_t size) {
  if (!machine || machine->check_there(out, "out")) return ARM_REFUSED;
  if (size != arm_saved_size())
    return machine->refuse(-1, "size", "be arm_saved_size()", static_cast<double>(size));
  Words words = {static_cast<unsigned char*>(out)};
  words.write(std::uint64_t{ARM_FINGERPRINT});
  auto whole = machine->machine.whole();
  arm_machine::Values values = {};
  for (int k = 0; k < arm::kOwnNumbers<Scene>; ++k) values[k] = machine->machine.parameter(k);
  arm_machine::for_each_saved_number(const_cast<arm_machine&>(*machine), whole, values,
                                     [&](const auto& number) { words.write(number); });
  words.write(std::uint64_t{words.sum});
  return ARM_OK;
}

namespace {

// ARM_OK if a machine can go on from saved bytes.
int check_saved(const arm_machine* machine, const void* saved) {
  const auto* begin = static_cast<const unsigned char*>(saved);
  Words words = {const_cast<unsigned char*>(begin)};
  std::uint64_t fingerprint = 0, sum = 0;
  double step = 0.0;
  std::int64_t steps_per_period = 0;
  words.read(fingerprint);
  words.read(step);
  words.read(steps_per_period);
  if (fingerprint != ARM_FINGERPRINT)
    return machine->refuse(-1, "saved machine", "be of this library", 0.0);
  if (step != machine->step)
    return machine->refuse(-1, "saved machine", "have this step [s]", step);
  if (steps_per_period != machine->steps_per_period)
    return machine->refuse(-1, "saved machine", "have as many steps per period",
                           static_cast<double>(steps_per_period));
  while (words.at != begin + arm_saved_size() - kWord) words.pass();
  const std::uint64_t expected = words.sum;
  words.read(sum);
  return sum == expected ? ARM_OK : machine->refuse(-1, "saved machine", "be as it was saved", 0.0);
}

void take_saved(arm_machine* machine, const void* saved) {
  Words words = {const_cast<unsigned char*>(static_cast<const unsigned char*>(saved)) + kWord};
  arm_machine::Machine::Whole whole = {};
  arm_machine::Values values = {};
  arm_machine::for_each_saved_number(*machine, whole, values,
                                     [&](auto& number) { words.read(number); });
  for (int k = 0; k < arm::kOwnNumbers<Scene>; ++k) machine->machine.set_parameter(k, values[k]);
  if constexpr (Scene::external_wrench)
    for (int j = 0; j < arm_machine::N; ++j) machine->set_external_wrench(j, machine->given[j]);
  machine->machine.restore(whole);
}

}  // namespace

ARM_ONCE int arm_restore(arm_machine* machine, const void* saved, std::int64_t size) {
  if (!machine || machine->check_there(saved, "saved machine")) return ARM_REFUSED;
  if (size != arm_saved_size())
    return machine->refuse(-1, "size", "be arm_saved_size()", static_cast<double>(size));
  if (check_saved(machine, saved)) return ARM_REFUSED;
  take_saved(machine, saved);
  return ARM_OK;
}

int arm_get_truth(const arm_machine* machine, arm_truth* out) {
  constexpr int N = arm_machine::N;
  if (!machine || machine->check_size(out)) return ARM_REFUSED;
  const auto& x = machine->machine.state();
  double current[N], angle[N], speed[N], torque[N];
  machine->machine.report(current, angle, speed);
  if (out->gear_torque) machine->machine.gear_torques(torque);
  const double* const from[] = {current, angle, speed, x.q, x.v, torque};
  double* const to[] = {out->current, out->motor_angle, out->motor_speed,
                        out->q,       out->v,           out->gear_torque};
  for (int row = 0; row < 6; ++row)
    for (int j = 0; to[row] && j < N; ++j) to[row][j] = from[row][j];
  out->fault = machine->machine.faulty_joint();
  out->time = machine->machine.time();
  if (out->energy) *out->energy = machine->machine.energy();
  return machine->result();
}

void arm_get_winding_temperatures(const arm_machine* machine, double* out) {
  if (machine && out) machine->machine.winding_temperatures(out);
}

ARM_ONCE int arm_set_truth(arm_machine* machine, const arm_truth* truth) {
  constexpr int N = arm_machine::N;
  if (!machine || machine->check_size(truth)) return ARM_REFUSED;
  double current[N], angle[N], speed[N];
  auto x = machine->machine.state();
  machine->machine.report(current, angle, speed);
  double* const to[] = {current, angle, speed, x.q, x.v};
  const double* const from[] = {truth->current, truth->motor_angle, truth->motor_speed, truth->q,
                                truth->v};
  const char* const names[] = {"current", "motor angle", "motor speed", "q", "v"};
  for (int row = 0; row < 5; ++row) {
    if (!from[row]) continue;
    if (machine->check_finite(from[row], names[row])) return ARM_REFUSED;
    for (int j = 0; j < N; ++j) to[row][j] = from[row][j];
  }
  int result = ARM_OK;
  machine->machine.numbers_now().for_each_drive([&](const auto& drive, int j) {
    const auto behind = drive.at_rest_behind(x.q[j], x.v[j]);
    const double limit = drive.motor.largest_current();
    const auto differs = [&](const double* given, double one, double other) {
      return given && arm::magnitude(one - other) > 1e-9 * (1.0 + arm::magnitude(other));
    };
    if (!drive.driven && truth->current && current[j] != 0.0)
      result = machine->refuse(j, names[0], "be 0 without a motor", current[j]);
    if (limit > 0.0 && arm::magnitude(current[j]) > limit)
      result = machine->refuse(j, names[0], "be within the current limit", current[j]);
    if (!drive.elastic && differs(truth->motor_angle, angle[j], drive.motor_angle(behind)))
      result = machine->refuse(j, names[1], "be that of the link, which it turns with", angle[j]);
    if (!drive.elastic && differs(truth->motor_speed, speed[j], drive.motor_speed(behind)))
      result = machine->refuse(j, names[2], "be that of the link, which it turns with", speed[j]);
    auto put = input_of(drive, j, x, 0.0);
    drive.put_motor(put, current[j], angle[j], speed[j]);
    put_states(drive, j, 0, put, x);
  });
  if (result != ARM_OK) return result;
  machine->machine.put(x, false);
  machine->sensors.begin(machine->machine, machine->tick(), false);
  return ARM_OK;
}

int arm_advance(arm_machine* machine, const double* command, std::int64_t steps) {
  if (!machine || machine->check_finite(command, "command") || machine->check_count(steps, "steps"))
    return ARM_REFUSED;
  const double* given = machine->with_power(command);
  machine->go(steps, [&](std::int64_t some) { machine->machine.advance(given, some); });
  return machine->result();
}

int arm_run(arm_machine* machine, const double* command, std::int64_t rows, std::int64_t steps,
            double* q) {
  if (!machine || machine->check_there(command, "command") || machine->check_there(q, "q") ||
      machine->check_count(rows, "rows") || machine->check_count(steps, "steps"))
    return ARM_REFUSED;
  for (std::int64_t row = 0; row < rows; ++row)
    if (machine->check_finite(command + row * arm_machine::N, "command")) return ARM_REFUSED;
  machine->follow(command, rows, steps, q);
  return machine->result();
}

namespace {

[[maybe_unused]] void write_flow(const arm::EnergyFlow<Scene>& flow, double* out) {
  for (int j = 0; j < arm_machine::N; ++j) {
    out[j] = flow.given[j];
    out[arm_machine::N + j] = flow.dissipated[j];
  }
}

[[maybe_unused]] int refuse_flow(const arm_machine* machine) {
  if (!machine) return ARM_REFUSED;
  return machine->refuse(-1, "energy_flow", "be true in the scene", 0.0);
}

}  // namespace

int arm_powers(const arm_machine* machine, const double* command, double* out) {
  if constexpr (!Scene::energy_flow) {
    return refuse_flow(machine);
  } else {
    if (!machine || machine->check_finite(command, "command") || machine->check_there(out, "out"))
      return ARM_REFUSED;
    write_flow(machine->machine.powers(machine->with_power(command)), out);
    return ARM_OK;
  }
}

int arm_advance_metered(arm_machine* machine, const double* command, std::int64_t steps,
                        double* out) {
  if constexpr (!Scene::energy_flow) {
    return refuse_flow(machine);
  } else {
    if (!machine || machine->check_finite(command, "command") || machine->check_there(out, "out") ||
        machine->check_count(steps, "steps"))
      return ARM_REFUSED;
    arm::EnergyFlow<Scene> flow;
    const double* given = machine->with_power(command);
    machine->go(steps,
                [&](std::int64_t some) { machine->machine.advance_metered(given, some, flow); });
    write_flow(flow, out);
    return machine->result();
  }
}

ARM_ONCE int arm_linear_drives(const arm_machine* machine, std::int32_t loaded, double* out) {
  constexpr int K = arm::most_states<Scene>();
  if (!out) return K;
  if (!machine) return 0;
  const auto copy = [&](const double* from, int count) {
    for (int k = 0; k < count; ++k) *out++ = from[k];
  };
  machine->machine.numbers_now().for_each_drive([&](const auto& drive, int) {
    const auto linear = arm::LinearDrive<K, arm::most_modes<Scene>()>::of(
        drive, loaded ? drive.held_under_load : 0);
    *out++ = drive.states;
    *out++ = drive.carried();
    copy(linear.D, K);
    for (int k = 0; k < K; ++k) copy(linear.F[k], K + 3);
    copy(linear.G, K + 3);
    using Drive = std::remove_cvref_t<decltype(drive)>;
    for (int column = 0; column < K + 3; ++column) {
      typename Drive::template Input<double> one = {};
      linear.template set<Drive>(one, column, 1.0);
      out[column] = drive.current(one), out[K + 3 + column] = drive.motor_angle(one);
    }
    out += 2 * (K + 3);
  });
  return K;
}

ARM_ONCE int arm_linearise(const arm_machine* machine, double* x, double* command,
                           std::int32_t as_it_is, std::int32_t slides, double* out) {
  using Linear = arm::Linearisation<Scene>;
  if (!machine || machine->check_there(x, "x") || machine->check_finite(command, "command") ||
      machine->check_there(out, "out"))
    return ARM_REFUSED;
  const arm::Numbers<Scene>& numbers = machine->machine.numbers_now();
  arm::State<Scene> at = machine->machine.state();
  if (!as_it_is)
    for (int k = 0; k < Linear::numbers; ++k) Linear::number(at, k) = x[k];
  arm::bound_commands(numbers, at, command);
  arm::follow_at_once(numbers, at, command);
  for (int k = 0; k < Linear::numbers; ++k) x[k] = Linear::number(at, k);
  const Linear linear(numbers, at, command, slides);
  linear.write(at, command, out);
  linear.write_structure(out + Linear::rows * (Linear::numbers + arm_machine::N + 1));
  return ARM_OK;
}

void arm_forward_dynamics(const arm_machine* machine, std::int64_t count, const double* q,
                          const double* v, const double* tau, double* a) {
  constexpr int N = arm_machine::N;
  using Links = arm::Links<Scene>;
  if (!machine || !q || !v || !tau || !a) return;
  for (std::int64_t row = 0; row < count; ++row, q += N, v += N, tau += N, a += N) {
    Links::Dynamics links;
    double x[N];
    Links::dynamics_apart(machine->machine.numbers_now(), q, v, links);
    for (int j = 0; j < N; ++j) x[j] = tau[j] - links.nle[j];
    arm::Cholesky<N> factors;
    factors.factor(links.M.at);
    factors.solve(x);
    for (int j = 0; j < N; ++j) a[j] = x[j];
  }
}

void arm_link_dynamics(const arm_machine* machine, std::int64_t count, const double* q,
                       const double* v, double* M, double* nle) {
  constexpr int N = arm_machine::N;
  using Links = arm::Links<Scene>;
  if (!machine || !q || !v || !M || !nle) return;
  for (std::int64_t row = 0; row < count; ++row, q += N, v += N, M += N * N, nle += N) {
    Links::Dynamics links;
    Links::dynamics_apart(machine->machine.numbers_now(), q, v, links);
    for (int i = 0; i < N; ++i) {
      nle[i] = links.nle[i];
      for (int j = 0; j < N; ++j) M[i * N + j] = links.M.at[i < j ? i : j][i < j ? j : i];
    }
  }
}

#pragma GCC visibility pop
