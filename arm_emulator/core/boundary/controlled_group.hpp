// A group of a fleet's arms in closed loop with control code in C.
//
// While all of its arms are in their lanes, what they measure and are commanded stays in rows of
// lanes. A group with an arm that is elsewhere goes through its machines for that period.
#pragma once

#include "boundary/fleet.hpp"

class ControlledGroup {
 public:
  static constexpr int N = arm_fleet::N, lanes = arm_fleet::lanes;

  ControlledGroup(arm_fleet& fleet, int group, const arm_fleet_control& control,
                  const arm_fleet_measurement& measured)
      : fleet_(fleet),
        g_(group),
        first_(group * lanes),
        end_(fleet.end_of(group)),
        control_(control),
        measured_(measured) {}

  // `links`: null, or where the links' positions after each period go. False if a command was
  // refused.
  bool follow(std::int64_t periods, double* links) {
    bool glides = false, sound = true;
    for (; periods > 0 && sound; --periods) {
      if (!glides) glides = may_glide();
      if (glides)
        sound = glide(*fleet_.group[g_], links, glides);
      else
        sound = walk(links);
      if (links) links += std::int64_t{fleet_.arms} * N;
    }
    if (glides) note();
    return sound;
  }

 private:
  struct alignas(64) Rows {
    std::int64_t encoder[N * lanes] = {}, brake[N * lanes] = {};
    double current[N * lanes] = {}, applied[N * lanes] = {}, value[N * lanes] = {};
    std::uint8_t powered[lanes] = {};
  };

  // Whether the lanes know all that a period needs.
  bool may_glide() const {
    bool may = arm_fleet::in_lanes && control_.step_rows;
    for (int k = first_; k < end_ && may; ++k) {
      const arm_machine& arm = *fleet_.machine[k];
      const arm_joint_command* joint = control_.joint + k * N;
      may = fleet_.is_abreast(k) && arm.powered && !fleet_.lent[k] &&
            arm.check_commands(joint, nullptr) == ARM_OK;
      for (int j = 0; j < N; ++j) may = may && joint[j].enable;
      for (int b = 0; b < Scene::brakes; ++b)
        may = may && arm.closes_brake(b, joint, nullptr) == arm.machine.wants_brake(b) &&
              !arm.machine.wants_brake(b) && !arm.machine.brake_closed(b);
    }
    return may;
  }

  // A period in lanes. `glides`: whether all arms are still there after it.
  template <class Group>
  bool glide([[maybe_unused]] Group& group, [[maybe_unused]] double* links, bool& glides) {
    if constexpr (requires { group.is_abreast(0); }) {
      group.measure(rows_.encoder, rows_.current, rows_.applied);
      for (int l = 0; l < end_ - first_; ++l) rows_.powered[l] = 1;
      step_rows();
      double given[lanes * N] = {};
      for (int j = 0; j < N; ++j)
        for (int l = 0; l < end_ - first_; ++l) given[l * N + j] = rows_.value[j * lanes + l];
      if (!all_finite(given)) return false;
      group.follow(given, 0, 1, fleet_.machine[first_]->steps_per_period,
                   links ? links + first_ * N : nullptr);
      for (int k = first_; k < end_; ++k) glides = glides && fleet_.is_abreast(k);
      if (glides) return true;
      note();
      for (int k = first_; k < end_; ++k) {
        if (fleet_.is_abreast(k)) continue;
        double (&applied)[N] = fleet_.machine[k]->applied;
        for (int j = 0; j < N; ++j) applied[j] = given[(k - first_) * N + j];
        fleet_.machine[k]->machine.bound(applied);
      }
    }
    return true;
  }
  bool all_finite(const double* given) const {
    double sum = 0.0;
    for (int k = 0; k < N * lanes; ++k) sum += given[k] - given[k];
    if (arm::is_finite(sum)) return true;
    for (int k = first_; k < end_; ++k)
      if (fleet_.machine[k]->check_finite(given + (k - first_) * N, "value")) {
        fleet_.refused = k;
        return false;
      }
    return true;
  }
  // Put down in the machines what their lanes were commanded.
  void note() {
    for (int k = first_; k < end_; ++k)
      fleet_.if_in_lane(k, [&](const auto& group, int l) {
        fleet_.machine[k]->answered = -1;
        for (int j = 0; j < N; ++j) fleet_.machine[k]->applied[j] = group.applied(l, j);
      });
  }

  // A period arm by arm.
  bool walk(double* links) {
    for (int k = first_; k < end_; ++k) fleet_.measure(k, measured_);
    if (control_.step_rows)
      step_transposed();
    else
      control_.step(control_.with, first_, end_ - first_, measured_.joint, measured_.powered,
                    control_.joint);
    for (int k = first_; k < end_; ++k)
      if (fleet_.machine[k]->check_commands(control_.joint + k * N, nullptr)) {
        fleet_.refused = k;
        return false;
      }
    fleet_.exchange(g_, control_.joint, nullptr, -1);
    for (int k = first_; links && k < end_; ++k) {
      arm_fleet_truth where = {};
      where.q = links;
      fleet_.get_truth(k, where);
    }
    return true;
  }
  void step_transposed() {
    const auto for_each = [&](auto&& act) {
      for (int k = first_; k < end_; ++k)
        for (int j = 0; j < N; ++j) act(k * N + j, j * lanes + k - first_);
    };
    for_each([&](int from, int to) {
      const arm_joint_measurement& joint = measured_.joint[from];
      rows_.encoder[to] = joint.encoder, rows_.brake[to] = joint.brake;
      rows_.current[to] = joint.current, rows_.applied[to] = joint.applied;
    });
    for (int k = first_; k < end_; ++k) rows_.powered[k - first_] = measured_.powered[k];
    step_rows();
    for_each([&](int to, int from) { control_.joint[to].value = rows_.value[from]; });
    for (std::int64_t& closed : rows_.brake) closed = 0;
  }
  void step_rows() {
    const arm_fleet_rows rows = {first_,        end_ - first_, lanes,         0,
                                 rows_.encoder, rows_.brake,   rows_.current, rows_.applied,
                                 rows_.powered, rows_.value};
    control_.step_rows(control_.with, &rows);
  }

  arm_fleet& fleet_;
  int g_, first_, end_;
  const arm_fleet_control& control_;
  const arm_fleet_measurement& measured_;
  Rows rows_;
};
