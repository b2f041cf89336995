// Changes of the arms of a fleet between their servo periods.
#pragma once

#include "fleet.hpp"

namespace {

int check_change(const arm_machine* arm, const arm_fleet_change& change) {
  arm::GivenWrench given = {};
  switch (change.kind) {
    case ARM_CHANGES_PARAMETER:
      if (change.place < 0 || change.place >= Scene::parameters)
        return arm->refuse(-1, "parameter", "be varied in this scene", 0.0);
      if (!is_within_bounds(change.place, change.value))
        return arm->refuse(-1, "parameter", "be within its bounds", change.value);
      return ARM_OK;
    case ARM_CHANGES_WRENCH:
      return check_wrench(arm, change.place, change.wrench, given);
    case ARM_CHANGES_POWER:
      return ARM_OK;
    default:
      return arm->refuse(-1, "change", "be of a known kind", change.kind);
  }
}

// The first of these arms with a change that it refuses; -1: none.
int find_refused_change(const arm_fleet& fleet, int first, int arms, const arm_fleet_way& way) {
  for (int k = first; way.change && k < first + arms; ++k)
    for (std::int64_t c = way.first_change[k]; c < way.first_change[k + 1]; ++c)
      if (check_change(fleet.machine[k], way.change[c])) return k;
  return -1;
}

// The changes of a group of arms, in their order.
class GroupChanges {
 public:
  static constexpr int lanes = arm_fleet::lanes;
  static constexpr std::int64_t never = INT64_MAX;

  // From a period of the call on; those before are made. `begins`: the call has taken no step yet.
  GroupChanges(arm_fleet& fleet, int group, const arm_fleet_way& way, std::int64_t period,
               bool begins)
      : fleet_(fleet),
        first_(group * lanes),
        end_(fleet.end_of(group)),
        way_(way),
        start_ticks_(fleet.status[group].start_ticks) {
    if (!way.change) return;
    for (int k = first_; k < end_; ++k) {
      std::int64_t& next = next_[k - first_];
      next = way.first_change[k];
      if (begins) start_ticks_[k - first_] = fleet.ticks_of(k);
      while (next < way.first_change[k + 1] && due_period(k) < period) ++next;
      update_due(k);
    }
  }
  // Whether some are due before a period of the call.
  bool has_due(std::int64_t period) const { return period >= due_; }
  void apply_due(std::int64_t period) {
    due_ = never;
    for (int k = first_; k < end_; ++k) {
      std::int64_t& next = next_[k - first_];
      for (; next < way_.first_change[k + 1] && due_period(k) <= period; ++next)
        apply_change(k, way_.change[next]);
      update_due(k);
    }
  }

 private:
  std::int64_t due_period(int k) const {
    return way_.change[next_[k - first_]].tick - start_ticks_[k - first_];
  }
  void update_due(int k) {
    if (next_[k - first_] < way_.first_change[k + 1] && due_period(k) < due_) due_ = due_period(k);
  }
  void apply_change(int k, const arm_fleet_change& change) {
    fleet_.move_to_machine(k);
    arm_machine* const arm = fleet_.machine[k];
    if (change.kind == ARM_CHANGES_PARAMETER)
      arm->machine.set_parameter(change.place, change.value);
    else if (change.kind == ARM_CHANGES_WRENCH)
      arm_set_external_wrench(arm, change.place, change.wrench);
    else
      arm_power(arm, change.value != 0.0);
  }

  arm_fleet& fleet_;
  int first_, end_;
  const arm_fleet_way& way_;
  std::int64_t next_[lanes] = {};
  std::int64_t (&start_ticks_)[lanes];  // ticks of the arms when the call began
  std::int64_t due_ = never;            // period of the call
};

}  // namespace
