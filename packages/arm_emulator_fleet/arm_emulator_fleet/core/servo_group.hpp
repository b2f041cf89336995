// Our servo in the loop with a group of arms, in lanes: servo.c, which is included for them as for
// a single arm. SERVO_FLEET_LANES: arms of a group.
#pragma once

#include <cstddef>
#include <utility>

#include "servo.c"
#include "servo_fleet.h"

namespace abreast {

#undef SERVO_H
#define SERVO_LANES SERVO_FLEET_LANES
#include "servo.c"

}  // namespace abreast

namespace {

constexpr int L = SERVO_FLEET_LANES;
using Numbers = abreast::servo_real;
using Counts = abreast::servo_count;
using Mask = abreast::servo_mask;
typedef uint8_t Bytes __attribute__((vector_size(L)));

// A joint of a group of arms.
struct Joint {
  abreast::servo_joint numbers;
  abreast::servo_state state;
};

template <class Vector, class Number>
Vector load(const Number* row) {
  Vector all;
  __builtin_memcpy(&all, row, sizeof all);
  return all;
}

// Every field of both structs has eight bytes, as a lane has.
constexpr std::size_t kField = 8;
static_assert(sizeof(abreast::servo_joint) == L * sizeof(servo_joint));

void put_lane(abreast::servo_joint& to, int lane, const servo_joint& from) {
  auto* bytes = reinterpret_cast<unsigned char*>(&to);
  const auto* source = reinterpret_cast<const unsigned char*>(&from);
  for (std::size_t field = 0; field < sizeof from / kField; ++field)
    __builtin_memcpy(bytes + (field * L + lane) * kField, source + field * kField, kField);
}
void forget_lane(abreast::servo_state& state, int lane) {
  auto* bytes = reinterpret_cast<unsigned char*>(&state);
  for (std::size_t field = 0; field < sizeof state / (kField * L); ++field)
    __builtin_memset(bytes + (field * L + lane) * kField, 0, kField);
}

// A group of arms.
struct Group {
  abreast::servo clock;
  Counts tick;  // servo periods since the reset
  Counts next;  // the tick at which a row of targets comes
};
constexpr int64_t kNever = INT64_MAX;

// Targets that come to arms now.
struct Targets {
  Mask come = {};   // with these rows, or those of the period before again
  Mask fresh = {};  // with these rows
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
int64_t take_row_at(const servo_fleet& fleet, int32_t k, int l, int64_t tick, Targets& targets) {
  int64_t& row = fleet.row[k];
  const int64_t last = fleet.first_row[k + 1] - 1;
  while (row < last && fleet.since[row + 1] <= tick) ++row;
  targets.q[l] = fleet.q + row * fleet.joints;
  targets.fresh[l] = -1;
  return row < last ? fleet.since[row + 1] : kNever;
}
// The row of all arms that comes at a tick, if one does. Returns the tick of the next one.
int64_t take_row(const servo_fleet& fleet, int32_t k, int l, int64_t tick, Targets& targets) {
  if (!fleet.rows) return kNever;
  const int64_t due = tick / fleet.periods_per_row, next = (due + 1) * fleet.periods_per_row;
  if (tick + fleet.periods_per_row != next) return next;
  const bool last = due >= fleet.rows;  // it stands there
  const int64_t row = last ? fleet.rows - 1 : due;
  const int64_t at = row * fleet.row_stride + k * fleet.arm_stride;
  targets.q[l] = fleet.q + at;
  targets.v[l] = fleet.v && !last ? fleet.v + at : nullptr;
  targets.tau[l] = fleet.tau ? fleet.tau + at : nullptr;
  targets.come[l] = targets.fresh[l] = -1;
  if (row + kAhead >= fleet.rows) return next;
  const int64_t ahead = at + kAhead * fleet.row_stride;
  __builtin_prefetch(fleet.q + ahead);
  if (fleet.v) __builtin_prefetch(fleet.v + ahead);
  if (fleet.tau) __builtin_prefetch(fleet.tau + ahead);
  return next;
}

// Targets of a period of the arms from `first` on.
void take_rows(const servo_fleet& fleet, int32_t first, Group& group, Targets& targets) {
  const Mask due = group.next <= group.tick;
  if (fleet.since) targets.come = ~Mask{};  // each in every period
  if (!abreast::any(due)) return;
  for (int l = 0; l < L; ++l)
    if (due[l])
      group.next[l] =
          (fleet.since ? take_row_at : take_row)(fleet, first + l, l, group.tick[l], targets);
}

}  // namespace

struct servo_joints_abreast {
  Group* group;
  Joint* of;
};

namespace {

Joint* joints_of(const servo_fleet& fleet, int32_t arm) {
  return &fleet.abreast->of[int64_t{arm} / L * fleet.joints];
}

// Have the servo of an arm forget everything.
void reset_servo(servo_fleet& fleet, int32_t arm) {
  Mask lane = {};
  lane[arm % L] = -1;
  Group& group = fleet.abreast->group[arm / L];
  abreast::begin_clock(&group.clock, lane);
  group.tick[arm % L] = group.next[arm % L] = 0;
  if (fleet.since) fleet.row[arm] = fleet.first_row[arm];
  for (int32_t j = 0; j < fleet.joints; ++j) forget_lane(joints_of(fleet, arm)[j].state, arm % L);
}

// Take over what an arm's targets are timed by.
void aim_servo(servo_fleet& fleet, int32_t arm) {
  Group& group = fleet.abreast->group[arm / L];
  group.clock.motion_period[arm % L] = fleet.arm[arm].motion_period;
  group.next[arm % L] = 0;
}

void retune_servo(servo_fleet& fleet, int32_t arm, const servo_joint* joint) {
  for (int32_t j = 0; j < fleet.joints; ++j)
    put_lane(joints_of(fleet, arm)[j].numbers, arm % L, joint[j]);
}

// Take over the numbers of the arms of a group of so many arms, and forget everything. Lanes of no
// arm repeat the last one.
void begin_servos(servo_fleet& fleet, int32_t of_group, int32_t arms) {
  Group& group = fleet.abreast->group[of_group];
  group = Group();
  for (int32_t j = 0; j < fleet.joints; ++j) joints_of(fleet, of_group * L)[j] = Joint();
  for (int32_t k = of_group * L; k < (of_group + 1) * L; ++k) {
    const servo& own = fleet.arm[k < arms ? k : arms - 1];
    group.clock.watchdog.hold_after[k % L] = own.watchdog.hold_after;
    group.clock.watchdog.cut_after[k % L] = own.watchdog.cut_after;
    group.next[k % L] = kNever;
    retune_servo(fleet, k, own.joint);
    if (k >= arms) continue;
    reset_servo(fleet, k);
    aim_servo(fleet, k);
  }
}

}  // namespace

void servo_fleet_step(void* with, const arm_fleet_rows* rows) {
  const servo_fleet& fleet = *static_cast<servo_fleet*>(with);
  const int32_t of_group = rows->first / L;
  Group& group = fleet.abreast->group[of_group];
  Joint* const joint = &fleet.abreast->of[of_group * fleet.joints];
  Targets targets;
  const abreast::servo_past past = abreast::measure_at(&group.clock, group.tick * fleet.period);
  take_rows(fleet, rows->first, group, targets);
  group.tick += 1;
  const bool aims = abreast::any(targets.come), fresh = abreast::any(targets.fresh);
  const Numbers since = aims ? abreast::aim_now(&group.clock, targets.come) : Numbers{};
  const auto powered = __builtin_convertvector(load<Bytes>(rows->powered), Counts) != 0;
  const abreast::servo_turn turn = abreast::turn_of(&group.clock, powered);
  for (int32_t j = 0; j < fleet.joints; ++j) {
    const abreast::servo_joint* numbers = &joint[j].numbers;
    abreast::servo_state* state = &joint[j].state;
    const int32_t at = fleet.place[j] * L;
    Numbers command;
    Mask lost = abreast::measure_joint(
        numbers, state, &past, load<Counts>(rows->encoder + at), load<Numbers>(rows->current + at),
        load<Numbers>(rows->applied + at), load<Counts>(rows->brake + at) != 0);
    if (aims) {
      Numbers q = state->q_target, v = {}, tau = {};
      if (fresh) {
        q = targets.fresh ? Targets::of(targets.q, j) : q;
        if (fleet.v) v = Targets::of(targets.v, j);
        if (fleet.tau) tau = Targets::of(targets.tau, j);
      }
      abreast::take_target(state, targets.come, q, v, tau, since);
    }
    lost |= abreast::command_joint(numbers, state, &turn, &command);
    __builtin_memcpy(rows->value + at, &command, sizeof command);
    if (abreast::any(lost))
      for (int l = 0; l < rows->arms; ++l) fleet.arm[rows->first + l].restarts += lost[l] != 0;
  }
}
