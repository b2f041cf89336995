// The machine of an instance: the calls of arm.h that it takes, their results in `struct Data`.
//
// Included after the table of variables (unit.py). The machine is a source of its own.
#pragma once

#include <cstddef>
#include <cstdint>

#include "data.hpp"
#include "numerics/finite.hpp"
#include "tick.h"
#include "variable.hpp"

namespace fmu {

class Machine {
 public:
  explicit Machine(Data& data) : data_(data) {}
  ~Machine() { arm_delete(at_.machine); }
  Machine(const Machine&) = delete;
  Machine& operator=(const Machine&) = delete;

  // False if that fails.
  bool make() {
    arm_description description = {};
    description.size = sizeof description;
    arm_describe(&description);
    fingerprint_ = description.fingerprint;
    for (int k = 0; k < kParameters; ++k) {
      parameters_[k].size = sizeof parameters_[k];
      arm_describe_parameter(k, &parameters_[k]);
    }
    for (int j = 0; j < N; ++j) {
      joints_[j].size = sizeof joints_[j];
      arm_describe_joint(j, &joints_[j]);
    }
    arm_options options = {};
    options.size = sizeof options;
    options.core = -1;
    options.step = kIntegrationStep;
    options.steps_per_period = kStepsPerPeriod;
    options.parameters = kParameterStart;
    at_.machine = arm_new(&options);
    return at_.machine;
  }

  std::uint64_t fingerprint() const { return fingerprint_; }
  // Null: no such joint.
  const char* name_of(int joint) const {
    return joint >= 0 && joint < N ? joints_[joint].name : nullptr;
  }
  void set_parameters(const double* values) {
    for (int k = 0; k < kParameters; ++k)
      arm_set_parameter(at_.machine, parameters_[k].name, values[k]);
  }
  void put_at(bool power, const double* q, const double* v) {
    arm_power(at_.machine, power);
    arm_reset(at_.machine, q, v);
  }

  // Go on by one tick; returns what tick_exchange does.
  int exchange(const Inputs& held) {
    arm_power(at_.machine, held.power);
    if (put_external_wrenches(held) != ARM_OK) return ARM_REFUSED;
    arm_joint_command commands[N];
    for (int j = 0; j < N; ++j) {
      commands[j].mode = kModes[j];
      commands[j].enable = 0;
      if (held.enable[j]) commands[j].enable |= ARM_ENABLED;
      if (held.enable[j] && held.close_brake[j]) commands[j].enable |= ARM_CLOSE_BRAKE;
      commands[j].value = held.command[j];
    }
    const arm_command command = {sizeof command, 0, -1, commands, held.further};
    return tick_exchange(&at_, &command);
  }
  void measure() {
    tick_measure(&at_);
    data_.shown.powered = measurement_.powered;
  }
  void measure_truth() {
    Truth& to = data_.truth;
    arm_truth truth = {};
    truth.size = sizeof truth;
    truth.energy = &to.energy;
    truth.current = to.current;
    truth.motor_angle = to.motor_angle;
    truth.motor_speed = to.motor_speed;
    truth.q = to.q;
    truth.v = to.v;
    truth.gear_torque = to.gear_torque;
    arm_get_truth(at_.machine, &truth);
    arm_get_winding_temperatures(at_.machine, to.winding_temperature);
    arm_get_gear_temperatures(at_.machine, to.gear_temperature);
  }

  arm_refusal why() const {
    arm_refusal why = {};
    why.size = sizeof why;
    arm_why(at_.machine, &why);
    return why;
  }
  // Its time and its fault.
  arm_truth clock() const {
    arm_truth truth = {};
    truth.size = sizeof truth;
    arm_get_truth(at_.machine, &truth);
    return truth;
  }
  // Why a value is not taken; null if it is.
  const char* find_obstacle(const Variable& one, int k, double value) const {
    const int at = one.first + k;
    if (!arm::is_finite(value)) return "be finite";
    switch (one.rule) {
      case Rule::command:
        return joints_[at].modes || value == 0.0 ? nullptr : "be 0, the joint has no motor";
      case Rule::further:
        return kHasInput[at] || value == 0.0 ? nullptr
                                             : "be 0, the joint's motor has no such input";
      case Rule::wrench:
        return __builtin_fabs(value) <= ARM_LARGEST_WRENCH ? nullptr : "be at most 1e9";
      case Rule::start_q:
        return __builtin_fabs(value) <= kLargestQ[at] ? nullptr : "be near enough to be counted";
      case Rule::start_v:
        return __builtin_fabs(value) <= kLargestV ? nullptr : "be at most 1e6";
      case Rule::parameter:
        return value >= parameters_[at].least && value <= parameters_[at].most
                   ? nullptr
                   : "be within its bounds";
      default:
        return nullptr;
    }
  }

  // The joint that a value commands, by its name; null: it is no command.
  const char* commanded(const Variable& one, int k) const {
    return one.rule == Rule::command ? joints_[one.first + k].name : nullptr;
  }

  static std::size_t saved_size() { return static_cast<std::size_t>(arm_saved_size()); }
  void save(unsigned char* bytes) const { arm_save(at_.machine, bytes, arm_saved_size()); }
  bool restore(const unsigned char* bytes) {
    return arm_restore(at_.machine, bytes, arm_saved_size()) == ARM_OK;
  }

 private:
  int put_external_wrenches(const Inputs& in) {
    if constexpr (kExternalWrench)
      for (int j = 0; j < L; ++j) {
        arm_wrench wrench = {};
        wrench.size = sizeof wrench;
        wrench.axes = in.external_world_axes ? ARM_WORLD_AXES : ARM_LINK_AXES;
        for (int k = 0; k < 3; ++k) {
          wrench.force[k] = in.external_force[3 * j + k];
          wrench.moment[k] = in.external_moment[3 * j + k];
          wrench.point[k] = in.external_point[3 * j + k];
        }
        if (arm_set_external_wrench(at_.machine, j, &wrench) != ARM_OK) return ARM_REFUSED;
      }
    return ARM_OK;
  }

  Data& data_;
  std::uint64_t fingerprint_ = 0;
  arm_parameter parameters_[kParameters + 1] = {};
  arm_joint_description joints_[N] = {};
  arm_measurement measurement_ = {sizeof measurement_,
                                  0,
                                  0,
                                  -1,
                                  data_.shown.joint,
                                  data_.shown.sensors,
                                  data_.shown.imu,
                                  data_.shown.current_d,
                                  data_.shown.readings,
                                  data_.shown.further};
  tick_machine at_ = {sizeof at_,    N, nullptr,       arm_measure, arm_exchange,
                      arm_get_truth, 0, &measurement_, 0,           nullptr};
};

}  // namespace fmu
