// Our servo in the loop with the arms of a fleet. What an arm does by its clock and its watchdog is
// decided arm by arm, and what its joints do in lanes: both are servo.c, which is included for
// either. SERVO_FLEET_LANES: arms of a group.
#include "servo_fleet.h"

#include <array>
#include <cstring>
#include <utility>
#include <vector>

#include "servo.c"

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

// A joint of a group of arms.
struct Joint {
  abreast::servo_joint numbers;
  abreast::servo_state state;
};

template <class Vector, class Number>
Vector load(const Number* row) {
  Vector all;
  std::memcpy(&all, row, sizeof all);
  return all;
}

// Of both structs, as of their lanes, every field has eight bytes.
constexpr std::size_t kField = 8;
static_assert(sizeof(abreast::servo_joint) == L * sizeof(servo_joint));

void put_lane(abreast::servo_joint& to, int lane, const servo_joint& from) {
  auto* bytes = reinterpret_cast<unsigned char*>(&to);
  const auto* given = reinterpret_cast<const unsigned char*>(&from);
  for (std::size_t field = 0; field < sizeof from / kField; ++field)
    std::memcpy(bytes + (field * L + lane) * kField, given + field * kField, kField);
}
void forget_lane(abreast::servo_state& state, int lane) {
  auto* bytes = reinterpret_cast<unsigned char*>(&state);
  for (std::size_t field = 0; field < sizeof state / (kField * L); ++field)
    std::memset(bytes + (field * L + lane) * kField, 0, kField);
}

// Targets that come to arms now, and where they stand.
struct Targets {
  Mask come = {};
  Numbers since = {};
  const double *q[L] = {}, *v[L] = {}, *tau[L] = {};

  // Made of registers: numbers that are stored one by one are not soon loaded as a vector.
  Numbers of(const double* const (&rows)[L], int32_t j) const {
    return [&]<int... l>(std::integer_sequence<int, l...>) {
      return Numbers{(rows[l] ? rows[l][j] : 0.0)...};
    }(std::make_integer_sequence<int, L>{});
  }
};

// Rows of many arms lie far apart: those to come are fetched so many ahead.
constexpr int64_t kAhead = 4;

void aim_at_ticks(const servo_fleet& fleet, servo& arm, int32_t k, int l, int64_t tick,
                  Targets& targets) {
  int64_t& row = fleet.row[k];
  while (row + 1 < fleet.first_row[k + 1] && fleet.since[row + 1] <= tick) ++row;
  targets.come[l] = -1;
  targets.since[l] = aim_now(&arm);
  targets.q[l] = fleet.q + row * fleet.joints;
}

// The row that comes at a tick, -1 for none: mostly that of the arm before, without a division.
struct Coming {
  int64_t tick = -1, row = -1;

  int64_t at(const servo_fleet& fleet, int64_t now) {
    if (now != tick) {
      tick = now;
      const int64_t whole = now / fleet.periods_per_row;
      row = now == whole * fleet.periods_per_row ? whole : -1;
    }
    return row;
  }
};

void aim(const servo_fleet& fleet, servo& arm, int32_t k, int l, int64_t tick, Coming& coming,
         Targets& targets) {
  if (fleet.since) return aim_at_ticks(fleet, arm, k, l, tick, targets);
  const int64_t given = fleet.rows ? coming.at(fleet, tick) : -1;
  if (given < 0) return;
  const bool last = given >= fleet.rows;  // it stands there
  const int64_t row = last ? fleet.rows - 1 : given;
  const int64_t at = row * fleet.row_stride + k * fleet.arm_stride;
  targets.come[l] = -1;
  targets.since[l] = aim_now(&arm);
  targets.q[l] = fleet.q + at;
  targets.v[l] = fleet.v && !last ? fleet.v + at : nullptr;
  targets.tau[l] = fleet.tau ? fleet.tau + at : nullptr;
  if (row + kAhead >= fleet.rows) return;
  const int64_t ahead = at + kAhead * fleet.row_stride;
  __builtin_prefetch(fleet.q + ahead);
  if (fleet.v) __builtin_prefetch(fleet.v + ahead);
  if (fleet.tau) __builtin_prefetch(fleet.tau + ahead);
}

}  // namespace

struct servo_joints_abreast {
  std::vector<Joint> of;
};

void servo_fleet_begin(servo_fleet* fleet, int32_t arms) {
  const int32_t joints = fleet->joints, groups = (arms + L - 1) / L;
  servo_fleet_end(fleet);
  fleet->abreast = new servo_joints_abreast{std::vector<Joint>(groups * joints, Joint{})};
  for (int32_t k = 0; k < groups * L; ++k)
    for (int32_t j = 0; j < joints; ++j)
      put_lane(fleet->abreast->of[k / L * joints + j].numbers, k % L,
               fleet->arm[k < arms ? k : arms - 1].joint[j]);
  const std::vector<uint8_t> all(arms, 1);
  servo_fleet_reset(fleet, arms, all.data());
}

void servo_fleet_end(servo_fleet* fleet) {
  delete fleet->abreast;
  fleet->abreast = nullptr;
}

void servo_fleet_reset(servo_fleet* fleet, int32_t arms, const uint8_t* mask) {
  for (int32_t k = 0; k < arms; ++k) {
    if (!mask[k]) continue;
    servo_reset(&fleet->arm[k]);
    fleet->tick[k] = 0;
    if (fleet->since) fleet->row[k] = fleet->first_row[k];
    for (int32_t j = 0; j < fleet->joints; ++j)
      forget_lane(fleet->abreast->of[k / L * fleet->joints + j].state, k % L);
  }
}

void servo_fleet_retune(servo_fleet* fleet, int32_t arm, const servo_joint* joint) {
  for (int32_t j = 0; j < fleet->joints; ++j)
    put_lane(fleet->abreast->of[arm / L * fleet->joints + j].numbers, arm % L, joint[j]);
}

void servo_fleet_step(void* with, const arm_fleet_rows* rows) {
  const servo_fleet& fleet = *static_cast<servo_fleet*>(with);
  abreast::servo_turn turn = {};
  abreast::servo_past past = {};
  Targets targets;
  Coming coming;
  for (int l = 0; l < rows->arms; ++l) {
    const int32_t k = rows->first + l;
    const int64_t tick = fleet.tick[k]++;
    servo& arm = fleet.arm[k];
    const servo_past before = measure_at(&arm, tick * fleet.period);
    past.learns[l] = -before.learns, past.changed[l] = before.changed;
    past.passed[l] = before.passed, past.ahead[l] = before.ahead;
    aim(fleet, arm, k, l, tick, coming, targets);
    const servo_turn one = turn_of(&arm, rows->powered[l]);
    turn.cut[l] = -one.cut, turn.follows[l] = -one.follows, turn.latches[l] = -one.latches;
    turn.ahead[l] = one.ahead, turn.period[l] = one.period;
  }
  const bool aims = abreast::any(targets.come), cuts = abreast::any(turn.cut);
  Joint* const joint = &fleet.abreast->of[rows->first / L * fleet.joints];
  for (int32_t j = 0; j < fleet.joints; ++j) {
    const abreast::servo_joint* numbers = &joint[j].numbers;
    abreast::servo_state* state = &joint[j].state;
    const int32_t at = fleet.place[j] * L;
    Numbers command;
    abreast::expect_load(numbers, state, &past);
    Mask lost =
        abreast::observe(numbers, state, load<Counts>(rows->encoder + at),
                         load<Numbers>(rows->current + at), load<Numbers>(rows->applied + at));
    abreast::learn(numbers, state, &past);
    state->braked = load<Counts>(rows->brake + at);
    if (aims)
      abreast::take_target(state, targets.come, targets.of(targets.q, j), targets.of(targets.v, j),
                           targets.of(targets.tau, j), targets.since);
    lost |= abreast::pursue(numbers, state, &turn, &command) & ~turn.cut;
    if (cuts) {
      const Numbers none = {};
      command = turn.cut ? none : command;
      state->integral = turn.cut ? none : state->integral;
      state->voltage = turn.cut ? none : state->voltage;
      state->stood |= abreast::flag_of(turn.cut, 1);
    }
    std::memcpy(rows->value + at, &command, sizeof command);
    if (abreast::any(lost))
      for (int l = 0; l < rows->arms; ++l) fleet.arm[rows->first + l].restarts += lost[l] != 0;
  }
}
