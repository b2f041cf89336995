// The objects of a drive that parts of the scene declare: further inputs of its motor,
// and outputs of its joint.
#pragma once

#include <vector>

#include "values.hpp"

namespace fieldbus {

class DeclaredValues {
 public:
  DeclaredValues(const drives_machine& machine, int joint) : all_(*machine.at->measurement) {
    const int joints = machine.at->joints;
    const int* row = machine.place + joint * machine.outputs * DRIVES_UNITS;
    for (const Reported& one : kReported)
      for (int unit = 0; unit < DRIVES_UNITS; ++unit, ++row)
        for (int axis = 0; axis < (one.per_unit ? kAxes : 1) && *row >= 0; ++axis) {
          const int sub = one.per_unit ? 1 + kAxes * unit + axis : 0;
          const int slot = find_slot(one.index, static_cast<std::uint8_t>(sub));
          reported_.push_back({slot, one.value, {joints, joint, *row, axis}});
        }
    row = machine.input + joint * machine.inputs;
    for (const Taken& one : kTaken)
      taken_.push_back({find_slot(one.index, 0), *row * joints + joint, *row++ >= 0});
  }

  void publish(Values& values) const {
    for (const Report& one : reported_) values.set_at(one.slot, one.value(all_, one.at));
  }
  // Write what the motor takes into the rows of arm_command.further.
  void command(const Values& values, double* further) const {
    for (const Input& one : taken_)
      if (one.there) further[one.place] = real(values.at(one.slot));
  }
  // Whether a value would go to a motor that has no such input.
  bool is_refused(int slot, std::int64_t value) const {
    for (const Input& one : taken_)
      if (one.slot == slot && !one.there) return real(value) != 0.0F;
    return false;
  }

 private:
  struct Report {
    int slot;
    decltype(Reported::value) value;
    Place at;
  };
  struct Input {
    int slot, place;
    bool there;
  };

  const arm_measurement& all_;
  std::vector<Report> reported_;
  std::vector<Input> taken_;
};

}  // namespace fieldbus
