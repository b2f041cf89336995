// The arms of a fleet: each in its machine, or in its lane beside others.
#pragma once

#include "arm_fleet.h"
#include "boundary/boundary.hpp"
#include "lanes.hpp"
#include "state_rows.hpp"

struct arm_fleet {
  using Machine = arm_machine::Machine;
  // As of a machine: drives, and joints of a row.
  static constexpr int N = arm_machine::N, J = arm_machine::J;
  // Lanes are not for two threads, nor for drives without a regular mode.
  static constexpr bool together =
      std::is_same_v<Machine::Threads, arm::OneThread<Scene, Machine::Stepper>> &&
      arm::is_ever_regular<Scene>();
  static constexpr int lanes = together ? arm::kNativeLanes : 1;
  // Whether states of lanes are in rows (state_rows.hpp), where all groups have the same tables.
#ifdef ARM_STATES_IN_ROWS
  static constexpr bool has_rows = lanes > 1 && !arm::drives_vary<Scene>();
#else
  static constexpr bool has_rows = false;
#endif
  using Group = arm::SideBySide<Scene, lanes, has_rows>;
  using Rows = arm::StateRows<Group, has_rows>;

  // Whether lanes have all data of measurements and commands; other data is read from the machine.
  static constexpr bool in_lanes =
      lanes > 1 && !arm_machine::looks && !Machine::heats && Scene::inputs == 0;
  // Whether some steps of lanes have events: then a device takes the others in a kernel of their
  // own.
  static constexpr bool has_events_in_lanes = in_lanes && arm::kStepsApart<Scene>;
  static constexpr bool has_current_d =
      arm::any_drive<Scene>([](const auto& drive) { return drive.has_current_d; });

  // Places for so many arms, which `build` fills.
  arm_fleet(const arm_options& options, int count)
      : arms(count),
        step(options.step),
        steps_per_period(options.steps_per_period),
        machine(new arm_machine*[count]()),
        lent(new std::int32_t[count]()),
        group(new Group*[groups()]()),
        known(new Known[groups()]),
        common(options.step, arm::Numbers<Scene>(options.parameters)),
        rows(groups()) {}
  // Make the arms of a group; false if the options make no sense.
  bool build(int g, const arm_options& options) {
    Machine* members[lanes];
    for (int k = g * lanes; k < end_of(g); ++k) {
      arm_options own = options;
      own.parameters += std::int64_t{k} * Scene::parameters;
      machine[k] = arm_new(&own);
      if (!machine[k]) return false;
      members[k % lanes] = &machine[k]->machine;
    }
    group[g] = new Group(options.step, members, end_of(g) - g * lanes, common);
    rows.clear(g);
    return true;
  }
  ~arm_fleet() {
    for (int k = 0; k < groups(); ++k) delete group[k];
    delete[] group;
    delete[] known;
    for (int k = 0; k < arms; ++k) arm_delete(machine[k]);
    delete[] machine;
    delete[] lent;
  }
  arm_fleet(const arm_fleet&) = delete;

  // Take a group through rows of commands, see SideBySide; sensors look at every tick. Arms without
  // power get none of them. `taken`: steps of the first row, by `follow_smoothly`.
  void follow(int g, const double* command, std::int64_t stride, std::int64_t rows,
              std::int64_t steps, double* q, std::int64_t taken = 0) {
    const int first = g * lanes, end = end_of(g);
    put_down(g);
    known[g].has_applied = false;
    bool powered = true;
    for (int k = first; k < end; ++k) powered = powered && machine[k]->powered;
    if (powered && J == N) {
      follow_command(g, command, stride, rows, steps, q, taken);
    } else {
      for (; rows > 0; --rows, command += stride, q += stride) {
        double given[lanes * N] = {}, at[lanes * N];
        for (int k = first; k < end; ++k) {
          const auto own = machine[k]->with_power(command + (k - first) * J);
          for (int j = 0; j < N; ++j) given[(k - first) * N + j] = own.of[j];
        }
        follow_command(g, given, 0, 1, steps, at);
        put_joints(g, at, q);
      }
    }
    settle_lent(g);
  }
  // Take the steps of a row that come before the first event; whether these were all.
  bool follow_smoothly(int g, const double* command, std::int64_t steps, double* q) {
    known[g].taken = 0;
    if constexpr (in_lanes && J == N) {
      if (steps == 0 || !is_free(*group[g], g)) return false;
      put_down(g);
      known[g].has_applied = false;
      known[g].taken = group[g]->follow_smoothly(command, steps, q);
      return known[g].taken == steps;
    }
    return false;
  }
  // Positions of the drives of a group, one arm after the other, to a row of joints.
  void put_joints(int g, const double* at, double* q) const {
    for (int k = 0; k < end_of(g) - g * lanes; ++k) arm_machine::to_joints(at + k * N, q + k * J);
  }
  void follow_command(int g, const double* command, std::int64_t stride, std::int64_t rows,
                      std::int64_t steps, double* q, [[maybe_unused]] std::int64_t taken = 0) {
    if constexpr (!arm_machine::looks) {
      group[g]->follow(command, stride, rows, steps, q, 1, taken);
    } else {
      const int first = g * lanes, end = end_of(g);
      for (; rows > 0; --rows, command += stride, q += q ? stride : 0) {
        for (int k = first; k < end; ++k) settle(k);
        if (steps == 0) group[g]->follow(command, stride, 1, 0, q);
        for (std::int64_t left = steps; left > 0;) {
          std::int64_t some = left;  // up to the next tick of one of them
          for (int k = first; k < end; ++k) {
            const std::int64_t period = machine[k]->steps_per_period;
            const std::int64_t due = period - machine[k]->machine.steps() % period;
            if (machine[k]->machine.faulty_joint() < 0 && due < some) some = due;
          }
          group[g]->follow(command, stride, 1, some, q);
          for (int k = first; k < end; ++k) settle(k), machine[k]->look();
          left -= some;
        }
      }
    }
  }

  // One servo period under the commands that each takes.
  void exchange(int g, const arm_joint_command* joint, const double* further, std::int64_t tick) {
    const int first = g * lanes, end = end_of(g);
    double given[lanes * N] = {};
    put_down(g);
    for (int k = first; k < end; ++k) {
      take_commands(k, joint + k * J, further ? further + k * Scene::inputs * J : nullptr, tick);
      for (int j = 0; j < N; ++j) given[(k - first) * N + j] = machine[k]->applied[j];
    }
    follow_command(g, given, 0, 1, steps_per_period, nullptr);
    for (int k = first; k < end; ++k)
      if_in_lane(k, [&](const auto& lanes, int l) {
        for (int j = 0; j < N; ++j) machine[k]->applied[j] = lanes.applied(l, j);
      });
    settle_lent(g);
  }

  // Whether the lanes of a group know all that periods under these commands need.
  bool may_glide(int g, const arm_joint_command* joint) {
    for (int k = g * lanes * J; k < end_of(g) * J; ++k)
      if (!joint[k].enable || joint[k].enable & ARM_CLOSE_BRAKE ||
          joint[k].mode != arm::kModes.at[arm::drive_of<Scene>(k % J)])
        return false;
    return is_free(*group[g], g);
  }
  // Whether all of its arms are in their lanes, with power and open brakes.
  template <class G>
  bool is_free([[maybe_unused]] const G& own, [[maybe_unused]] int g) {
    if constexpr (in_lanes) {
      if (is_marked_free(own, g)) return true;
      for (int k = g * lanes; k < end_of(g); ++k) {
        if (!own.is_abreast(k % lanes) || !machine[k]->powered || lent[k]) return false;
        for (int b = 0; b < Scene::brakes; ++b)
          if (machine[k]->machine.wants_brake(b) || machine[k]->machine.brake_closed(b))
            return false;
      }
      known[g].free_since = own.departures();
      return true;
    }
    return false;
  }
  bool is_marked_free(const auto& own, int g) const {
    return known[g].free_since == own.departures();
  }
  // Periods in lanes, of a group that may, under commands in answer to a tick, in rows of lanes,
  // one per drive; the positions then go to `q` if it is not null. Whether all arms are still there
  // after them. `taken`: steps of the first period, by `glide_smoothly`.
  bool glide(int g, const double* given, std::int64_t tick, std::int64_t periods, double* q,
             std::int64_t taken = 0) {
    if (J == N || !q) {
      group[g]->follow(given, 0, periods, steps_per_period, q, lanes, taken);
    } else {
      double at[lanes * N];
      group[g]->follow(given, 0, periods, steps_per_period, at, lanes, taken);
      put_joints(g, at, q);
    }
    return answer(g, given, tick);
  }
  // Take the steps of such a period that come before the first event; whether these were all.
  bool glide_smoothly(int g, const double* given, std::int64_t tick, double* q) {
    if constexpr (in_lanes) {
      double at[J == N ? 1 : lanes * N];
      double* const positions = J == N || !q ? q : at;
      known[g].taken = group[g]->follow_smoothly(given, steps_per_period, positions, lanes);
      if (known[g].taken < steps_per_period) return false;
      if (J != N && q) put_joints(g, at, q);
      known[g].has_applied = known[g].answers = true;
      known[g].answered = tick;
      return true;
    }
    return false;
  }
  // Machines whose arms are in their lanes get what was commanded there before they are read.
  bool answer(int g, const double* given, std::int64_t tick) {
    known[g].has_applied = true;
    known[g].answered = tick;
    known[g].answers = are_abreast(g);
    if (!known[g].answers) note(g, given, tick);
    return known[g].answers;
  }
  // Put down in the machines what their lanes were commanded in answer to a tick.
  void note(int g, const double* given, std::int64_t tick) const {
    known[g].answers = false;
    for (int k = g * lanes; k < end_of(g); ++k) {
      machine[k]->answered = tick;
      double (&applied)[N] = machine[k]->applied;
      const auto from_lane = [&](const auto& group, int l) {
        for (int j = 0; j < N; ++j) applied[j] = group.applied(l, j);
      };
      if (if_in_lane(k, from_lane)) continue;
      for (int j = 0; j < N; ++j) applied[j] = given[j * lanes + k % lanes];
      machine[k]->machine.bound(applied);
    }
  }
  // The same with what a group that is in its lanes was commanded last, before a machine is read.
  void put_down(int g) const {
    if (known[g].answers) note(g, nullptr, known[g].answered);
  }
  std::int64_t answered(int k) const {
    const Known& of = known[k / lanes];
    return of.answers ? of.answered : machine[k]->answered;
  }
  // Periods under held commands. `taken`: steps of the first one, by `hold_smoothly`; -1: it has
  // not begun.
  void hold(int g, const arm_joint_command* joint, const double* further, std::int64_t tick,
            std::int64_t periods, std::int64_t taken = -1) {
    for (; periods > 0 && taken < 0 && !may_glide(g, joint); --periods)
      exchange(g, joint, further, tick);
    if (periods == 0) return;
    double given[lanes * N] = {};
    put_lanes(g, joint, given);
    glide(g, given, tick, periods, nullptr, taken < 0 ? 0 : taken);
  }
  // Take the steps of a period that come before the first event; whether these were all.
  bool hold_smoothly(int g, const arm_joint_command* joint, std::int64_t tick) {
    known[g].taken = -1;
    if (!may_glide(g, joint)) return false;
    double given[lanes * N] = {};
    put_lanes(g, joint, given);
    return glide_smoothly(g, given, tick, nullptr);
  }
  // Commands of joints to rows of lanes, one per drive.
  void put_lanes(int g, const arm_joint_command* joint, double* given) const {
    for (int k = g * lanes; k < end_of(g); ++k)
      for (int j = 0; j < J; ++j)
        given[arm::drive_of<Scene>(j) * lanes + k % lanes] = joint[k * J + j].value;
  }
  void take_commands(int k, const arm_joint_command* joint, const double* further,
                     std::int64_t tick) {
    bool stays = in_lanes && is_abreast(k);  // its lane bounds what it takes
    for (int b = 0; b < Scene::brakes; ++b)
      stays &= machine[k]->closes_brake(b, joint, nullptr) == machine[k]->machine.wants_brake(b);
    if (stays) {
      machine[k]->put_commands(joint, further, tick);
    } else {
      settle(k);
      machine[k]->take_commands(joint, further, tick);
    }
  }

  // Servo periods of an arm since its reset.
  std::int64_t ticks_of(int k) const {
    std::int64_t steps = 0;
    if (!if_in_lane(k, [&](const auto& group, int l) { steps = group.steps_taken(l); }))
      steps = machine[k]->machine.steps();
    return steps / steps_per_period;
  }

  // Move an arm from its lane to its machine, to be read or changed there.
  void settle(int k) const {
    put_down(k / lanes);
    group[k / lanes]->settle(k % lanes);
  }
  void settle_lent(int g) {
    for (int k = g * lanes; k < end_of(g); ++k)
      if (lent[k] > 0) settle(k);
  }
  // act(group, lane) if an arm is in a lane; whether it is.
  template <class Act>
  bool if_in_lane(int k, Act&& act) const {
    return if_abreast(*group[k / lanes], k % lanes, act);
  }
  template <class G, class Act>
  static bool if_abreast([[maybe_unused]] const G& own, [[maybe_unused]] int lane,
                         [[maybe_unused]] Act&& act) {
    if constexpr (requires { own.is_abreast(lane); })
      if (own.is_abreast(lane)) {
        act(own, lane);
        return true;
      }
    return false;
  }
  bool is_abreast(int k) const {
    return if_in_lane(k, [](const auto&, int) {});
  }
  bool are_abreast(int g) const {
    bool all = true;
    for (int k = g * lanes; k < end_of(g); ++k) all = all && is_abreast(k);
    return all;
  }
  int end_of(int g) const { return (g + 1) * lanes < arms ? (g + 1) * lanes : arms; }

  void measure(int k, arm_measurement* out) const {
    put_down(k / lanes);
    const bool done = in_lanes && if_in_lane(k, [&](const auto& lanes, int l) {
                        arm_machine::Motors motors;
                        motors.steps = lanes.steps_taken(l);
                        lanes.report(l, motors.current, motors.angle, motors.speed);
                        machine[k]->measure(out, motors);
                      });
    if (done) return;
    settle(k);
    machine[k]->measure(out);
  }

  void measure(int k, const arm_fleet_measurement& out) const {
    constexpr int M = arm_machine::Sensors::M;
    arm_joint_measurement joint[J];
    arm_measurement one = {};
    one.size = sizeof one;
    one.joint = out.joint ? out.joint + k * J : joint;
    one.sensors = row_of(out.sensors, k * J);
    one.imu = row_of(out.imu, k * M);
    one.current_d = row_of(out.current_d, k * J);
    one.readings = row_of(out.readings, k * Scene::readings * J);
    one.further = row_of(out.further, k * Scene::inputs * J);
    measure(k, &one);
    if (out.powered) out.powered[k] = one.powered != 0;
    if (out.tick) out.tick[k] = one.tick;
    if (out.answered) out.answered[k] = one.answered;
  }
  void get_truth(int k, const arm_fleet_truth& out) const {
    arm_truth truth = {sizeof truth,
                       -1,
                       0.0,
                       row_of(out.energy, k),
                       row_of(out.current, k * J),
                       row_of(out.motor_angle, k * J),
                       row_of(out.motor_speed, k * J),
                       row_of(out.q, k * J),
                       row_of(out.v, k * J),
                       row_of(out.gear_torque, k * J)};
    if (!truth_in_lanes(k, truth)) {
      settle(k);
      arm_get_truth(machine[k], &truth);
    }
    if (out.fault) out.fault[k] = truth.fault;
    if (out.time) out.time[k] = truth.time;
    if (!out.encoder) return;
    arm_joint_measurement joint[J];
    arm_measurement measurement = {};
    measurement.size = sizeof measurement, measurement.joint = joint;
    measure(k, &measurement);
    for (int j = 0; j < J; ++j) out.encoder[k * J + j] = joint[j].encoder;
  }
  // Measurements and true states of a group; either may be null.
  void show(int g, const arm_fleet_measurement* measurement, const arm_fleet_truth* truth) const {
    if (show_in_lanes(*group[g], g, measurement, truth)) return;
    for (int k = g * lanes; k < end_of(g); ++k) {
      if (measurement) measure(k, *measurement);
      if (truth) get_truth(k, *truth);
    }
  }
  // The same without the machines; false if more is requested than lanes have.
  template <class G>
  bool show_in_lanes([[maybe_unused]] const G& own, int g, const arm_fleet_measurement* measurement,
                     const arm_fleet_truth* truth) const {
    if constexpr (in_lanes) {
      const bool of_gears = truth && truth->gear_torque;
      if ((truth && (truth->energy || truth->encoder)) || (of_gears && !G::has_gear_torques) ||
          (measurement && measurement->current_d && has_current_d) || !are_abreast(g))
        return false;
      alignas(64) double current[N * lanes], angle[N * lanes], speed[N * lanes], rows[2][N * lanes];
      if (measurement || (truth && (truth->current || truth->motor_angle || truth->motor_speed)))
        own.report(current, angle, speed);
      if (measurement) {
        put_applied(own, g, rows[0]);
        put_measurement(own, g, *measurement, current, angle, rows[0]);
      }
      if (!truth) return true;
      own.links(rows[0], rows[1]);
      put_rows(g, current, truth->current);
      put_rows(g, angle, truth->motor_angle);
      put_rows(g, speed, truth->motor_speed);
      put_rows(g, rows[0], truth->q);
      put_rows(g, rows[1], truth->v);
      if (of_gears) {
        own.gear_torques(rows[0]);
        put_rows(g, rows[0], truth->gear_torque);
      }
      for (int k = g * lanes; k < end_of(g); ++k) {
        if (truth->fault) truth->fault[k] = -1;
        if (truth->time) truth->time[k] = static_cast<double>(own.steps_taken(k % lanes)) * step;
      }
      return true;
    }
    return false;
  }
  // Commands that motors got in the newest servo period; lanes also keep those of a run since then.
  void put_applied(const auto& own, int g, double* rows) const {
    if (known[g].has_applied) return own.applied(rows);
    for (int k = g * lanes; k < end_of(g); ++k)
      for (int j = 0; j < N; ++j) rows[j * lanes + k % lanes] = machine[k]->applied[j];
  }
  void put_measurement(const auto& own, int g, const arm_fleet_measurement& out,
                       const double* current, const double* angle, const double* applied) const {
    const int first = g * lanes;
    const bool free = is_marked_free(own, g);
    std::int64_t steps = 0, tick = 0;
    for (int k = first; k < end_of(g); ++k) {
      for (int j = 0; out.joint && j < J; ++j) {
        const int drive = arm::drive_of<Scene>(j), at = drive * lanes + k - first;
        arm_joint_measurement& joint = out.joint[k * J + j];
        joint = {arm_machine::counts(drive, angle[at]), current[at], applied[at], 0, 0};
      }
      for (int b = 0; out.joint && !free && b < Scene::brakes; ++b)
        out.joint[k * J + Scene::braked[b]].brake = machine[k]->machine.brake_closed(b);
      for (int j = 0; out.sensors && j < J; ++j) out.sensors[k * J + j] = {};
      for (int j = 0; out.current_d && j < J; ++j) out.current_d[k * J + j] = 0.0;
      arm_machine::put_deflections(row_of(out.readings, k * Scene::readings * J),
                                   [&](int drive) { return angle[drive * lanes + k - first]; });
      if (out.powered) out.powered[k] = free || machine[k]->powered;
      if (out.tick && steps != own.steps_taken(k - first)) {  // mostly that of the arm before
        steps = own.steps_taken(k - first);
        tick = steps / steps_per_period;
      }
      if (out.tick) out.tick[k] = tick;
      if (out.answered) out.answered[k] = answered(k);
    }
  }
  // Rows of lanes to a row of all arms, if it is not null.
  void put_rows(int g, const double* rows, double* to) const {
    for (int k = g * lanes; to && k < end_of(g); ++k)
      for (int j = 0; j < J; ++j) to[k * J + j] = rows[arm::drive_of<Scene>(j) * lanes + k % lanes];
  }
  // Fill in what a lane has without its machine; false if more is requested.
  bool truth_in_lanes(int k, arm_truth& out) const {
    return !out.energy && !out.gear_torque && if_in_lane(k, [&](const auto& lanes, int l) {
      double row[5][N];
      lanes.report(l, row[0], row[1], row[2]);
      lanes.links(l, row[3], row[4]);
      double* const to[] = {out.current, out.motor_angle, out.motor_speed, out.q, out.v};
      for (int r = 0; r < 5; ++r)
        if (to[r]) arm_machine::to_joints(row[r], to[r]);
      out.time = static_cast<double>(lanes.steps_taken(l)) * step;
    });
  }
  template <class Number>
  static Number* row_of(Number* rows, std::int64_t first) {
    return rows ? rows + first : nullptr;
  }

  // The arm that refused last, of any thread; -1: none. Builtins: <atomic> takes a fifth of a
  // second in every fleet that is compiled.
  std::int32_t refused() const { return __atomic_load_n(&refused_, __ATOMIC_RELAXED); }
  void put_refused(std::int32_t arm) const { __atomic_store_n(&refused_, arm, __ATOMIC_RELAXED); }

  // OK if check(machine, arm) is for all arms of a mask.
  template <class Check>
  int check_all(const std::uint8_t* mask, Check&& check) const {
    put_refused(-1);
    for (int k = 0; k < arms; ++k)
      if ((!mask || mask[k]) && check(machine[k], k) != ARM_OK) {
        put_refused(k);
        return ARM_REFUSED;
      }
    return ARM_OK;
  }
  template <class Do>
  void for_all(const std::uint8_t* mask, Do&& act) {
    for (int k = 0; k < arms; ++k)
      if (!mask || mask[k]) settle(k), act(machine[k], k);
  }

  // The further inputs of commands, null if they have no such rows.
  static const double* further_of(const arm_command& command) {
    return command.size >= sizeof command ? command.further : nullptr;
  }
  // Whether the drives of these arms take these commands.
  bool takes(std::int32_t first, std::int32_t count, const arm_command* command) const {
    if (!command || command->size < offsetof(arm_command, further) || !command->joint) return false;
    const double* further = further_of(*command);
    for (std::int32_t k = first; k < first + count; ++k)
      if (machine[k]->check_commands(command->joint + k * J,
                                     row_of(further, k * Scene::inputs * J)))
        return false;
    return true;
  }
  int result_of(std::int32_t first, std::int32_t count) const {
    for (std::int32_t k = first; k < first + count; ++k)
      if (!is_abreast(k) && machine[k]->result() != ARM_OK) return ARM_DIVERGED;
    return ARM_OK;
  }
  // Whether there are so many arms from the first of a group on.
  bool has(std::int32_t first, std::int32_t count) const {
    return first >= 0 && first % lanes == 0 && count >= 0 && first <= arms && count <= arms - first;
  }
  int groups() const { return (arms + lanes - 1) / lanes; }
  // The state of a group, for as long as this lives; kernels read and change arms in its presence.
  struct State : Rows::State {
    State(const arm_fleet& fleet, int g)
        : Rows::State(fleet.rows, *fleet.group[g], g, fleet.common) {}
  };

  // Of a group while all of its arms are in their lanes, where its machines are not read.
  struct Known {
    std::int64_t free_since = -1;  // departures from its lanes when it was found free
    bool answers = false;          // its machines do not have the newest commands yet
    std::int64_t answered = -1;    // the tick of these
    bool has_applied = false;      // its lanes do, as no run has commanded them since
    // The members below serve a call that a device carries out period by period.
    bool has_refused = false;        // its control code has
    std::int64_t taken = -1;         // steps of the period before the first event; -1: not begun
    std::int64_t began[lanes] = {};  // ticks of the arms when the call began
  };

  int arms;
  double step;
  std::int64_t steps_per_period;
  arm_machine** machine;
  std::int32_t* lent;  // users of a single arm; while > 0 it leaves its lane after every call
  Group** group;
  Known* known;
  typename Group::Common common;
  Rows rows;

 private:
  mutable std::int32_t refused_ = -1;
};
