// The functions of arm.h that describe a scene's machine.
#pragma once

#include "boundary/arm_machine.hpp"

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
  all.joints = arm_machine::J;
  all.parameters = Scene::parameters;
  all.fingerprint = ARM_FINGERPRINT;
  all.supply_voltage = Scene::supply_voltage;
  all.imus = arm_machine::Sensors::M;
  all.readings = Scene::readings;
  all.inputs = Scene::inputs;
  all.arithmetic = ARM_ARITHMETIC;
  if (arm_scene_periods.steps_per_period > 0) {
    all.servo_period = arm_scene_periods.servo_period;
    all.step = arm_scene_periods.step;
    all.steps_per_period = arm_scene_periods.steps_per_period;
  }
  return copy_fields(out, all);
}

int arm_describe_joint(std::int32_t joint, arm_joint_description* out) {
  if (!out || out->size < offsetof(arm_joint_description, encoder_wrap) || joint < 0 ||
      joint >= arm_machine::J)
    return ARM_REFUSED;
  const int of_joint = arm::drive_of<Scene>(joint);
  arm_joint_description all = {};
  all.size = out->size;
  all.name = Scene::device[of_joint].name;
  all.kind =
      arm::joint_kind<Scene>(of_joint) == arm::JointKind::revolute ? ARM_REVOLUTE : ARM_PRISMATIC;
  all.counts_per_rad = Scene::device[of_joint].counts_per_rad;
  arm::for_each_drive<Scene>([&](const auto& drive, int j) {
    if (j != of_joint) return;
    all.modes = drive.driven ? arm::kModes.at[j] : 0;
    all.gear_ratio = drive.gear.Ng;
    all.current_limit = drive.motor.largest_current();
  });
  arm_machine::describe<arm_machine::Sensors>(of_joint, all);
  return copy_fields(out, all);
}

int arm_describe_reading(std::int32_t reading, std::int32_t joint, arm_reading* out) {
  if (!out || out->size < sizeof *out || reading < 0 || reading >= Scene::readings || joint < 0 ||
      joint >= arm_machine::J)
    return ARM_REFUSED;
  return arm::describe_reading<Scene>(reading, joint, out);
}

int arm_describe_input(std::int32_t input, std::int32_t joint, arm_reading* out) {
  if (!out || out->size < sizeof *out || input < 0 || input >= Scene::inputs || joint < 0 ||
      joint >= arm_machine::J)
    return ARM_REFUSED;
  joint = arm::drive_of<Scene>(joint);
  const arm::FurtherInput<arm_machine::N>& row = Scene::input[input];
  *out = {out->size, row.of[joint] >= 0, row.name, row.unit[joint]};
  return ARM_OK;
}

int arm_describe_parameter(std::int32_t index, arm_parameter* out) {
  if (!out || out->size < sizeof *out || index < 0 || index >= Scene::parameters)
    return ARM_REFUSED;
  const arm::Parameter& parameter = Scene::parameter[index];
  *out = {out->size, 0, parameter.name, parameter.least, parameter.most};
  return ARM_OK;
}

#pragma GCC visibility pop
