// The functions of arm.h for one scene's machine. Included last in a scene's unit, after its
// `struct Scene`.
#pragma once

#include "boundary/arm_machine.hpp"
#include "boundary/equation_point.hpp"

#pragma GCC visibility push(default)

namespace {

bool is_within_bounds(int k, double value) {
  const arm::Parameter& parameter = Scene::parameter[k];
  return arm::is_finite(value) && value >= parameter.least && value <= parameter.most;
}

}  // namespace

ARM_ONCE arm_machine* arm_new(const arm_options* options) {
  bool sound = options && options->size >= sizeof *options && options->core >= -1 &&
               arm::is_finite(options->step) && options->step > 0.0 &&
               options->steps_per_period > 0 && (options->parameters || !Scene::parameters);
  for (int k = 0; sound && k < Scene::parameters; ++k)
    sound = is_within_bounds(k, options->parameters[k]);
  if (!sound) return nullptr;
  arm_machine* machine = new arm_machine(*options);
  const double zero[arm_machine::N] = {};
  machine->machine.reset(zero, zero);
  machine->restart_sensors(true);
  return machine;
}
void arm_delete(arm_machine* machine) { delete machine; }

int arm_reset(arm_machine* machine, const double* q, const double* v) {
  if (!machine || machine->check_finite(q, "q") || machine->check_finite(v, "v"))
    return ARM_REFUSED;
  machine->clear_external_wrenches();
  machine->machine.set_brakes(!machine->powered);
  machine->machine.reset(arm_machine::Drives(q).of, arm_machine::Drives(v).of);
  machine->answered = -1;
  for (double& value : machine->applied) value = 0.0;
  machine->restart_sensors(true);
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
      machine->check_pointer(command->joint, "joint of the command") ||
      machine->check_measurement(out))
    return ARM_REFUSED;
  const double* further = command->size >= sizeof *command ? command->further : nullptr;
  if (machine->check_commands(command->joint, further)) return ARM_REFUSED;
  machine->apply_commands(command->joint, further, command->tick, command->came != 0);
  machine->advance_with_sensors(machine->steps_per_period, [&](std::int64_t steps) {
    machine->machine.advance(machine->applied, steps);
  });
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
  for (int k = 0; k < Scene::brakes; ++k) machine->machine.request_brake(k, !machine->powered);
  if constexpr (Scene::inputs > 0) {
    static constexpr double nothing[Scene::inputs * arm_machine::N + 1] = {};  // never empty
    if (!on) machine->machine.set_further_inputs(nothing);
  }
}

int arm_why(const arm_machine* machine, arm_refusal* out) {
  if (!machine || !out || out->size < sizeof *out) return ARM_REFUSED;
  *out = machine->why;
  return ARM_OK;
}

namespace {

// The place of a varied number in the list; -1: none of that name.
int find_parameter(const char* name) {
  for (int k = 0; name && k < Scene::parameters; ++k)
    if (__builtin_strcmp(Scene::parameter[k].name, name) == 0) return k;
  return -1;
}

}  // namespace

int arm_get_parameter(const arm_machine* machine, const char* name, double* value) {
  if (!machine || machine->check_pointer(value, "value")) return ARM_REFUSED;
  const int k = find_parameter(name);
  if (k < 0) return machine->refuse(-1, "parameter", "be varied in this scene", 0.0);
  *value = machine->machine.parameter(k);
  return ARM_OK;
}

int arm_set_parameter(arm_machine* machine, const char* name, double value) {
  if (!machine) return ARM_REFUSED;
  const int k = find_parameter(name);
  if (k < 0) return machine->refuse(-1, "parameter", "be varied in this scene", 0.0);
  if (!is_within_bounds(k, value))
    return machine->refuse(-1, "parameter", "be within its bounds", value);
  machine->machine.set_parameter(k, value);
  return ARM_OK;
}

namespace {

int check_wrench(const arm_machine* machine, std::int32_t link, const arm_wrench* wrench,
                 arm::GivenWrench& wrench_numbers) {
  const int joint = arm::kCoupled<Scene> ? -1 : arm::find_joint<Scene>(link);
  if (machine->check_wrench_link(link) || machine->check_size(wrench)) return ARM_REFUSED;
  if (wrench->axes != ARM_LINK_AXES && wrench->axes != ARM_WORLD_AXES)
    return machine->refuse(joint, "axes", "be one of enum arm_axes", wrench->axes);
  double* to = wrench_numbers.numbers;
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

int arm_set_external_wrench(arm_machine* machine, std::int32_t link, const arm_wrench* wrench) {
  arm::GivenWrench numbers = {};
  if (!machine || check_wrench(machine, link, wrench, numbers)) return ARM_REFUSED;
  machine->set_external_wrench(link, numbers);
  return ARM_OK;
}

int arm_get_external_wrench(const arm_machine* machine, std::int32_t link, arm_wrench* out) {
  if (!machine || machine->check_wrench_link(link) || machine->check_size(out)) return ARM_REFUSED;
  const double* of = machine->wrenches[Scene::external_wrench ? link : 0].numbers;
  for (double* vector : {out->point, out->force, out->moment})
    for (int k = 0; k < 3; ++k) vector[k] = *of++;
  out->axes = *of != 0.0 ? ARM_WORLD_AXES : ARM_LINK_AXES;
  return ARM_OK;
}

ARM_ONCE void arm_measure_time(arm_machine* machine) {
  if (machine) machine->measures_time = true;
}

ARM_ONCE std::int64_t arm_spent(const arm_machine* machine) {
  return machine ? machine->spent_ns : 0;
}

int arm_get_truth(const arm_machine* machine, arm_truth* out) {
  constexpr int N = arm_machine::N;
  if (!machine || machine->check_size(out)) return ARM_REFUSED;
  const auto& x = machine->machine.state();
  double current[N], angle[N], speed[N], torque[N];
  machine->machine.get_motor_signals(current, angle, speed);
  if (out->gear_torque) machine->machine.gear_torques(torque);
  const double* const from[] = {current, angle, speed, x.q, x.v, torque};
  double* const to[] = {out->current, out->motor_angle, out->motor_speed,
                        out->q,       out->v,           out->gear_torque};
  for (int row = 0; row < 6; ++row)
    if (to[row]) arm_machine::copy_to_joints(from[row], to[row]);
  out->fault = machine->faulty_joint();
  out->time = machine->machine.time();
  if (out->energy) *out->energy = machine->machine.energy();
  return machine->result();
}

ARM_ONCE std::int32_t arm_get_point(const arm_machine* machine, double* out) {
  using EquationPoint = arm::EquationPoint<Scene>;
  if (!machine || !out) return EquationPoint::size;
  for (int k = 0; k < EquationPoint::own; ++k) *out++ = machine->machine.parameter(k);
  for (int link = 0; link < EquationPoint::wrenches; ++link)
    for (double number : machine->wrenches[link].numbers) *out++ = number;
  auto x = machine->machine.state();
  arm::for_each_number(x, [&](double number) { *out++ = number; });
  return EquationPoint::size;
}

void arm_get_winding_temperatures(const arm_machine* machine, double* out) {
  double of_drives[arm_machine::N];
  if (!machine || !out) return;
  machine->machine.winding_temperatures(of_drives);
  arm_machine::copy_to_joints(of_drives, out);
}

void arm_get_gear_temperatures(const arm_machine* machine, double* out) {
  double of_drives[arm_machine::N];
  if (!machine || !out) return;
  machine->machine.gear_temperatures(of_drives);
  arm_machine::copy_to_joints(of_drives, out);
}

ARM_ONCE int arm_set_truth(arm_machine* machine, const arm_truth* truth) {
  constexpr int N = arm_machine::N;
  if (!machine || machine->check_size(truth)) return ARM_REFUSED;
  double current[N], angle[N], speed[N];
  auto x = machine->machine.state();
  machine->machine.get_motor_signals(current, angle, speed);
  double* const to[] = {current, angle, speed, x.q, x.v};
  const double* const from[] = {truth->current, truth->motor_angle, truth->motor_speed, truth->q,
                                truth->v};
  static constexpr char names[][12] = {"current", "motor angle", "motor speed", "q", "v"};
  for (int row = 0; row < 5; ++row) {
    if (!from[row]) continue;
    if (machine->check_finite(from[row], names[row])) return ARM_REFUSED;
    arm_machine::copy_to_drives(from[row], to[row]);
  }
  int result = ARM_OK;
  machine->machine.numbers().for_each_drive([&](const auto& drive, int j) {
    const auto behind = drive.make_rest_state(x.q[j], x.v[j]);
    const double limit = drive.motor.largest_current();
    const auto differs = [&](const double* row, double actual, double expected) {
      return row && arm::magnitude(actual - expected) > 1e-9 * (1.0 + arm::magnitude(expected));
    };
    const int joint = arm::find_joint<Scene>(j);
    if (!drive.driven && truth->current && current[j] != 0.0)
      result = machine->refuse(joint, names[0], "be 0 without a motor", current[j]);
    if (limit > 0.0 && arm::magnitude(current[j]) > limit)
      result = machine->refuse(joint, names[0], "be within the current limit", current[j]);
    if (!drive.elastic && differs(truth->motor_angle, angle[j], drive.motor_angle(behind)))
      result =
          machine->refuse(joint, names[1], "be that of the link, which it turns with", angle[j]);
    if (!drive.elastic && differs(truth->motor_speed, speed[j], drive.motor_speed(behind)))
      result =
          machine->refuse(joint, names[2], "be that of the link, which it turns with", speed[j]);
    auto put = input_of(drive, j, x, 0.0);
    drive.set_motor(put, current[j], angle[j], speed[j]);
    store_states(drive, j, 0, put, x);
  });
  if (result != ARM_OK) return result;
  machine->machine.set_state(x, false);
  machine->restart_sensors(false);
  return ARM_OK;
}

int arm_advance(arm_machine* machine, const double* command, std::int64_t steps) {
  if (!machine || machine->check_finite(command, "command") || machine->check_count(steps, "steps"))
    return ARM_REFUSED;
  const arm_machine::Drives applied = machine->apply_power(command);
  machine->advance_with_sensors(
      steps, [&](std::int64_t some) { machine->machine.advance(applied.of, some); });
  return machine->result();
}

int arm_run(arm_machine* machine, const double* command, std::int64_t rows, std::int64_t steps,
            double* q) {
  if (!machine || machine->check_pointer(command, "command") || machine->check_pointer(q, "q") ||
      machine->check_count(rows, "rows") || machine->check_count(steps, "steps"))
    return ARM_REFUSED;
  for (std::int64_t row = 0; row < rows; ++row)
    if (machine->check_finite(command + row * arm_machine::J, "command")) return ARM_REFUSED;
  machine->follow_commands(command, rows, steps, q);
  return machine->result();
}

#pragma GCC visibility pop

#ifndef __CUDA__  // cards compute; processors describe and meter
#include "boundary/description.hpp"
#include "boundary/metered_machine.hpp"
#endif
#include "boundary/saved_machine.hpp"
