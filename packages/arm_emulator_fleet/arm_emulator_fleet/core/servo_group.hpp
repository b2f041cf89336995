// Our servo in the loop with a group of arms, in lanes: servo.c, which is included for them as for
// a single arm. SERVO_FLEET_LANES: arms of a group.
#pragma once

#include <cstddef>
#include <utility>

#include "servo.c"
#include "servo_fleet.h"

namespace lane_servo {

#undef SERVO_H
#define SERVO_LANES SERVO_FLEET_LANES
#include "servo.c"

}  // namespace lane_servo

namespace {

constexpr int L = SERVO_FLEET_LANES;
using Numbers = lane_servo::servo_real;
using Counts = lane_servo::servo_count;
using Mask = lane_servo::servo_mask;
typedef uint8_t Bytes __attribute__((vector_size(L)));

// A joint of a group of arms.
struct Joint {
  lane_servo::servo_joint numbers;
  lane_servo::servo_state state;
};

template <class Vector, class Number>
Vector load(const Number* row) {
  Vector all;
  __builtin_memcpy(&all, row, sizeof all);
  return all;
}

// Every field of both structs has eight bytes, as a lane has.
constexpr std::size_t kField = 8;
static_assert(sizeof(lane_servo::servo_joint) == L * sizeof(servo_joint));

void write_lane(lane_servo::servo_joint& to, int lane, const servo_joint& from) {
  auto* bytes = reinterpret_cast<unsigned char*>(&to);
  const auto* source = reinterpret_cast<const unsigned char*>(&from);
  for (std::size_t field = 0; field < sizeof from / kField; ++field)
    __builtin_memcpy(bytes + (field * L + lane) * kField, source + field * kField, kField);
}
void clear_lane(lane_servo::servo_state& state, int lane) {
  auto* bytes = reinterpret_cast<unsigned char*>(&state);
  for (std::size_t field = 0; field < sizeof state / (kField * L); ++field)
    __builtin_memset(bytes + (field * L + lane) * kField, 0, kField);
}

// A group of arms.
struct Group {
  lane_servo::servo clock;
  Counts tick;  // servo periods since the reset
  Counts next;  // the tick at which a row of targets comes
};
constexpr int64_t kNever = INT64_MAX;

// Targets that come to arms now.
struct Targets {
  Mask is_active = {};  // with these rows, or those of the period before again
  Mask is_new = {};     // with these rows
  const double *q[L] = {}, *v[L] = {}, *tau[L] = {};

  // Made of registers: numbers that are stored one by one are not soon loaded as a vector.
  static Numbers of(const double* const (&rows)[L], int32_t j) {
    return [&]<int... l>(std::integer_sequence<int, l...>) {
      return Numbers{(rows[l] ? rows[l][j] : 0.0)...};
    }(std::make_integer_sequence<int, L>{});
  }
};

// Rows of many arms lie far apart: those to come are fetched so many ahead.
constexpr int64_t kAhead = 4;

// The row of an arm that holds from a tick on. Returns the tick of the next one.
int64_t select_row_of_arm(const servo_fleet& fleet, int32_t k, int l, int64_t tick,
                          Targets& targets) {
  int64_t& row = fleet.row[k];
  const int64_t last = fleet.first_row[k + 1] - 1;
  while (row < last && fleet.since[row + 1] <= tick) ++row;
  targets.q[l] = fleet.q + row * fleet.joints;
  targets.is_new[l] = -1;
  return row < last ? fleet.since[row + 1] : kNever;
}
// The row of all arms that comes at a tick, if one does. Returns the tick of the next one.
int64_t select_common_row(const servo_fleet& fleet, int32_t k, int l, int64_t tick,
                          Targets& targets) {
  if (!fleet.rows) return kNever;
  const int64_t due = tick / fleet.periods_per_row, next = (due + 1) * fleet.periods_per_row;
  if (tick + fleet.periods_per_row != next) return next;
  const bool last = due >= fleet.rows;  // it stands there
  const int64_t row = last ? fleet.rows - 1 : due;
  const int64_t at = row * fleet.row_stride + k * fleet.arm_stride;
  targets.q[l] = fleet.q + at;
  targets.v[l] = fleet.v && !last ? fleet.v + at : nullptr;
  targets.tau[l] = fleet.tau ? fleet.tau + at : nullptr;
  targets.is_active[l] = targets.is_new[l] = -1;
  if (row + kAhead >= fleet.rows) return next;
  const int64_t ahead = at + kAhead * fleet.row_stride;
  __builtin_prefetch(fleet.q + ahead);
  if (fleet.v) __builtin_prefetch(fleet.v + ahead);
  if (fleet.tau) __builtin_prefetch(fleet.tau + ahead);
  return next;
}

// Targets of a period of the arms from `first` on.
void select_rows(const servo_fleet& fleet, int32_t first, Group& group, Targets& targets) {
  const Mask due = group.next <= group.tick;
  if (fleet.since) targets.is_active = ~Mask{};  // each in every period
  if (!lane_servo::any(due)) return;
  for (int l = 0; l < L; ++l)
    if (due[l])
      group.next[l] = (fleet.since ? select_row_of_arm : select_common_row)(fleet, first + l, l,
                                                                            group.tick[l], targets);
}

}  // namespace

struct servo_lanes {
  Group* group;
  Joint* joint;
};

namespace {

Joint* find_joints(const servo_fleet& fleet, int32_t arm) {
  return &fleet.lanes->joint[int64_t{arm} / L * fleet.joints];
}

// Have the servo of an arm forget everything.
void reset_servo(servo_fleet& fleet, int32_t arm) {
  Mask lane = {};
  lane[arm % L] = -1;
  Group& group = fleet.lanes->group[arm / L];
  lane_servo::reset_clock(&group.clock, lane);
  group.tick[arm % L] = group.next[arm % L] = 0;
  if (fleet.since) fleet.row[arm] = fleet.first_row[arm];
  for (int32_t j = 0; j < fleet.joints; ++j) clear_lane(find_joints(fleet, arm)[j].state, arm % L);
}

// Take over what an arm's targets are timed by.
void update_targets(servo_fleet& fleet, int32_t arm) {
  Group& group = fleet.lanes->group[arm / L];
  group.clock.motion_period[arm % L] = fleet.arm[arm].motion_period;
  group.next[arm % L] = 0;
}

void retune_servo(servo_fleet& fleet, int32_t arm, const servo_joint* joint) {
  for (int32_t j = 0; j < fleet.joints; ++j)
    write_lane(find_joints(fleet, arm)[j].numbers, arm % L, joint[j]);
}

// Take over the numbers of the arms of a group of so many arms, and forget everything. Lanes of no
// arm repeat the last one.
void begin_servos(servo_fleet& fleet, int32_t group_index, int32_t arms) {
  Group& group = fleet.lanes->group[group_index];
  group = Group();
  for (int32_t j = 0; j < fleet.joints; ++j) find_joints(fleet, group_index * L)[j] = Joint();
  for (int32_t k = group_index * L; k < (group_index + 1) * L; ++k) {
    const servo& own = fleet.arm[k < arms ? k : arms - 1];
    group.clock.watchdog.hold_after[k % L] = own.watchdog.hold_after;
    group.clock.watchdog.cut_after[k % L] = own.watchdog.cut_after;
    group.next[k % L] = kNever;
    retune_servo(fleet, k, own.joint);
    if (k >= arms) continue;
    reset_servo(fleet, k);
    update_targets(fleet, k);
  }
}

}  // namespace

void servo_fleet_step(void* with, const arm_fleet_rows* rows) {
  const servo_fleet& fleet = *static_cast<servo_fleet*>(with);
  const int32_t group_index = rows->first / L;
  Group& group = fleet.lanes->group[group_index];
  Joint* const joint = &fleet.lanes->joint[group_index * fleet.joints];
  Targets targets;
  const lane_servo::servo_past past =
      lane_servo::advance_clock(&group.clock, group.tick * fleet.period);
  select_rows(fleet, rows->first, group, targets);
  group.tick += 1;
  const bool aims = lane_servo::any(targets.is_active), fresh = lane_servo::any(targets.is_new);
  const Numbers since =
      aims ? lane_servo::register_target(&group.clock, targets.is_active) : Numbers{};
  const auto powered = __builtin_convertvector(load<Bytes>(rows->powered), Counts) != 0;
  const lane_servo::servo_decision decision = lane_servo::decide_period(&group.clock, powered);
  for (int32_t j = 0; j < fleet.joints; ++j) {
    const lane_servo::servo_joint* numbers = &joint[j].numbers;
    lane_servo::servo_state* state = &joint[j].state;
    const int32_t at = fleet.place[j] * L;
    Numbers command;
    Mask lost = lane_servo::measure_joint(
        numbers, state, &past, load<Counts>(rows->encoder + at), load<Numbers>(rows->current + at),
        load<Numbers>(rows->applied + at), load<Counts>(rows->brake + at) != 0);
    if (aims) {
      Numbers q = state->q_target, v = {}, tau = {};
      if (fresh) {
        q = targets.is_new ? Targets::of(targets.q, j) : q;
        if (fleet.v) v = Targets::of(targets.v, j);
        if (fleet.tau) tau = Targets::of(targets.tau, j);
      }
      lane_servo::set_target(state, targets.is_active, q, v, tau, since);
    }
    lost |= lane_servo::command_joint(numbers, state, &decision, &command);
    __builtin_memcpy(rows->value + at, &command, sizeof command);
    if (lane_servo::any(lost))
      for (int l = 0; l < rows->arms; ++l) fleet.arm[rows->first + l].restarts += lost[l] != 0;
  }
}
