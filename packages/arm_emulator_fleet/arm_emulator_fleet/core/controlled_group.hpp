// A group of a fleet's arms in closed loop with control code in C.
//
// While all of its arms are in their lanes, what they measure and are commanded stays in rows of
// lanes. A group with an arm that is elsewhere goes through its machines for that period.
#pragma once

#include "fleet_changes.hpp"

class ControlledGroup {
 public:
  static constexpr int N = arm_fleet::N, J = arm_fleet::J, lanes = arm_fleet::lanes;

  // `period`: of the call, from which it goes on; `taken`: its steps that `advance_to_event` has
  // taken, -1: none, it has not begun.
  ControlledGroup(arm_fleet& fleet, int group, const arm_fleet_control& control,
                  const arm_fleet_measurement& measured, const arm_fleet_way& way,
                  std::int64_t period = 0, std::int64_t taken = -1)
      : fleet_(fleet),
        g_(group),
        first_(group * lanes),
        end_(fleet.end_of(group)),
        control_(control),
        measured_(measured),
        way_(way),
        period_(period),
        taken_(taken),
        changes_(fleet, group, way, period, period == 0 && taken < 0) {}

  // False if a command was refused.
  bool advance(std::int64_t periods) {
    bool sound = true;
    for (; periods > 0 && sound; --periods) {
      if (changes_.has_due(period_)) {
        in_lanes_ = false;
        changes_.apply_due(period_);
      }
      if (!in_lanes_) in_lanes_ = can_advance_in_lanes();
      sound = in_lanes_ ? command_lanes(*fleet_.group[g_]) : exchange_arms(position_row());
      if (sound && in_lanes_) advance_in_lanes(0);
      if (sound) end_period();
    }
    return sound;
  }
  // A period up to its first event, which `finish_period` then goes on from. False if a command was
  // refused; whether all steps are taken goes to `done`.
  bool advance_to_event(bool& done) {
    fleet_.status[g_].taken = -1;
    done = false;
    if (changes_.has_due(period_) || !can_advance_in_lanes()) return true;
    if (!command_lanes(*fleet_.group[g_])) return false;
    done = fleet_.advance_in_lanes_to_event(g_, arrange_drive_commands(), -1, position_row());
    if (done)
      end_period();
    else
      for_each_joint([&](int joint, int row) { control_.joint[joint].value = rows_.value[row]; });
    return true;
  }
  // The remaining steps of a period. False if a command was refused.
  bool finish_period() {
    if (taken_ < 0) return advance(1);
    for_each_joint([&](int joint, int row) { rows_.value[row] = control_.joint[joint].value; });
    advance_in_lanes(taken_);
    end_period();
    return true;
  }
  // The arm whose command was refused.
  int refused() const { return refused_; }

 private:
  struct alignas(64) Rows {
    std::int64_t encoder[J * lanes] = {}, brake[J * lanes] = {};
    double current[J * lanes] = {}, applied[J * lanes] = {}, value[J * lanes] = {};
    std::uint8_t powered[lanes] = {};
  };

  bool can_advance_in_lanes() {
    return control_.step_rows && fleet_.can_advance_in_lanes(g_, control_.joint);
  }
  // Where the positions after this period go.
  double* position_row() const {
    return way_.links ? way_.links + (period_ * fleet_.arms + first_) * J : nullptr;
  }
  void end_period() {
    ++period_;
    if (way_.look) way_.look(way_.with, first_, end_ - first_);
  }
  // Let control code command arms in lanes; false if a command is refused.
  template <class Group>
  bool command_lanes([[maybe_unused]] Group& group) {
    if constexpr (requires { group.is_in_lane(0); }) {
      alignas(64) double current[N * lanes], angle[N * lanes], speed[N * lanes], applied[N * lanes];
      group.get_motor_signals(current, angle, speed);
      fleet_.get_applied_commands(group, g_, applied);
      using LaneVector = arm::LanesOf<lanes>;
      for (int j = 0; j < J; ++j) {
        const int drive = arm::drive_of<Scene>(j);
        const auto counts = arm_machine::counts(drive, LaneVector::load(angle + drive * lanes));
        __builtin_memcpy(rows_.encoder + j * lanes, &counts, sizeof counts);
        copy_row(current + drive * lanes, rows_.current + j * lanes);
        copy_row(applied + drive * lanes, rows_.applied + j * lanes);
      }
      for (int l = 0; l < end_ - first_; ++l) rows_.powered[l] = 1;
      step_rows();
      return check_finite<LaneVector>();
    }
    return true;
  }
  void advance_in_lanes(std::int64_t taken) {
    in_lanes_ = fleet_.advance_in_lanes(g_, arrange_drive_commands(), -1, 1, position_row(), taken);
  }
  static void copy_row(const double* from, double* to) {
    __builtin_memcpy(to, from, lanes * sizeof(double));
  }
  // The commands in rows of lanes, one per drive.
  const double* arrange_drive_commands() {
    if constexpr (J == N) return rows_.value;
    for (int j = 0; j < J; ++j)
      copy_row(rows_.value + j * lanes, drives_ + arm::drive_of<Scene>(j) * lanes);
    return drives_;
  }
  template <class LaneVector>
  bool check_finite() {
    auto finite = typename LaneVector::type{} == typename LaneVector::type{};
    for (int j = 0; j < J; ++j) finite &= arm::is_finite(LaneVector::load(rows_.value + j * lanes));
    if (arm::all(finite)) return true;
    for (int k = first_; k < end_; ++k) {
      double given[J];
      for (int j = 0; j < J; ++j) given[j] = rows_.value[j * lanes + k - first_];
      if (fleet_.machine[k]->check_finite(given, "command")) {
        fleet_.set_refused(refused_ = k);
        return false;
      }
    }
    return true;
  }
  // A period arm by arm.
  bool exchange_arms(double* links) {
    for (int k = first_; k < end_; ++k) fleet_.measure(k, measured_);
    if (control_.step_rows)
      step_rows_of_arms();
    else
      control_.step(control_.with, first_, end_ - first_, measured_.joint, measured_.powered,
                    control_.joint);
    for (int k = first_; k < end_; ++k)
      if (fleet_.machine[k]->check_commands(control_.joint + k * J, nullptr)) {
        fleet_.set_refused(refused_ = k);
        return false;
      }
    fleet_.exchange(g_, control_.joint, nullptr, -1);
    for (int k = first_; links && k < end_; ++k) {
      arm_fleet_truth where = {};
      where.q = links - first_ * J;
      fleet_.get_truth(k, where);
    }
    return true;
  }
  // act(joint in rows of arms, in rows of lanes)
  void for_each_joint(auto&& act) {
    for (int k = first_; k < end_; ++k)
      for (int j = 0; j < J; ++j) act(k * J + j, j * lanes + k - first_);
  }
  void step_rows_of_arms() {
    for_each_joint([&](int from, int to) {
      const arm_joint_measurement& joint = measured_.joint[from];
      rows_.encoder[to] = joint.encoder, rows_.brake[to] = joint.brake;
      rows_.current[to] = joint.current, rows_.applied[to] = joint.applied;
    });
    for (int k = first_; k < end_; ++k) rows_.powered[k - first_] = measured_.powered[k];
    step_rows();
    for_each_joint([&](int to, int from) { control_.joint[to].value = rows_.value[from]; });
    for (std::int64_t& closed : rows_.brake) closed = 0;
  }
  void step_rows() {
    const arm_fleet_rows rows = {first_,        end_ - first_, lanes,         0,
                                 rows_.encoder, rows_.brake,   rows_.current, rows_.applied,
                                 rows_.powered, rows_.value};
    control_.step_rows(control_.with, &rows);
  }

  arm_fleet& fleet_;
  int g_, first_, end_, refused_ = -1;
  const arm_fleet_control& control_;
  const arm_fleet_measurement& measured_;
  const arm_fleet_way& way_;
  std::int64_t period_, taken_;
  GroupChanges changes_;
  bool in_lanes_ = false;
  Rows rows_;
  alignas(64) double drives_[J == N ? 1 : N * lanes] = {};
};
