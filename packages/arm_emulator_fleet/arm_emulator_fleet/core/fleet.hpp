// The arms of a fleet: each in its machine, or in its lane of a group.
//
// One struct, with a member for each function of arm_fleet.h, hence the length.
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
  static constexpr bool has_lanes =
      std::is_same_v<Machine::Threads, arm::OneThread<Scene, Machine::Stepper>> &&
      arm::is_ever_regular<Scene>();
  static constexpr int lanes = has_lanes ? arm::kNativeLanes : 1;
  // Whether states of lanes are in rows (state_rows.hpp), where all groups have the same tables.
#ifdef ARM_STATES_IN_ROWS
  static constexpr bool has_rows = lanes > 1 && !arm::drives_vary<Scene>();
#else
  static constexpr bool has_rows = false;
#endif
  using Group = arm::MachineLanes<Scene, lanes, has_rows>;
  using Rows = arm::StateRows<Group, has_rows>;

  // Whether lanes have all data of measurements and commands; other data is read from the machine.
  static constexpr bool has_signals_in_lanes = lanes > 1 && !arm_machine::has_sampled_sensors &&
                                               !Machine::has_winding_temperature &&
                                               Scene::inputs == 0;
  // Whether some steps of lanes have events: then a device takes the others in a kernel of their
  // own.
  static constexpr bool has_events_in_lanes = has_signals_in_lanes && arm::kHasLaneEvents<Scene>;
  static constexpr bool has_current_d =
      arm::any_drive<Scene>([](const auto& drive) { return drive.has_current_d; });

  // Places for so many arms, which `build` fills.
  arm_fleet(const arm_options& options, int count)
      : arms(count),
        step(options.step),
        steps_per_period(options.steps_per_period),
        machine(new arm_machine*[count]()),
        users(new std::int32_t[count]()),
        group(new Group*[groups()]()),
        status(new GroupStatus[groups()]),
        common(options.step, arm::Numbers<Scene>(options.parameters)),
        rows(groups()) {}
  // Make the arms of a group; false if the options make no sense.
  bool build(int g, const arm_options& options) {
    Machine* members[lanes];
    for (int k = g * lanes; k < end_of(g); ++k) {
      arm_options of_arm = options;
      of_arm.parameters += std::int64_t{k} * Scene::parameters;
      machine[k] = arm_new(&of_arm);
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
    delete[] status;
    for (int k = 0; k < arms; ++k) arm_delete(machine[k]);
    delete[] machine;
    delete[] users;
  }
  arm_fleet(const arm_fleet&) = delete;

  // Take a group through rows of commands, see MachineLanes; sensors look at every tick. Arms
  // without power get none of them. `taken`: steps of the first row, by `follow_to_event`.
  void follow_rows(int g, const double* command, std::int64_t stride, std::int64_t rows,
                   std::int64_t steps, double* q, std::int64_t taken = 0) {
    const int first = g * lanes, end = end_of(g);
    flush_commands(g);
    status[g].has_applied_commands = false;
    bool powered = true;
    for (int k = first; k < end; ++k) powered = powered && machine[k]->powered;
    if (powered && J == N) {
      follow_rows_with_sensors(g, command, stride, rows, steps, q, taken);
    } else {
      for (; rows > 0; --rows, command += stride, q += stride) {
        double given[lanes * N] = {}, at[lanes * N];
        for (int k = first; k < end; ++k) {
          const auto command_of_arm = machine[k]->apply_power(command + (k - first) * J);
          for (int j = 0; j < N; ++j) given[(k - first) * N + j] = command_of_arm.of[j];
        }
        follow_rows_with_sensors(g, given, 0, 1, steps, at);
        write_joints(g, at, q);
      }
    }
    move_shared_to_machines(g);
  }
  // Take the steps of a row that come before the first event; whether these were all.
  bool follow_to_event(int g, const double* command, std::int64_t steps, double* q) {
    status[g].taken = 0;
    if constexpr (has_signals_in_lanes && J == N) {
      if (steps == 0 || !is_driven(*group[g], g)) return false;
      flush_commands(g);
      status[g].has_applied_commands = false;
      status[g].taken = group[g]->follow_to_event(command, steps, q);
      return status[g].taken == steps;
    }
    return false;
  }
  // Positions of the drives of a group, one arm after the other, to a row of joints.
  void write_joints(int g, const double* at, double* q) const {
    for (int k = 0; k < end_of(g) - g * lanes; ++k)
      arm_machine::copy_to_joints(at + k * N, q + k * J);
  }
  void follow_rows_with_sensors(int g, const double* command, std::int64_t stride,
                                std::int64_t rows, std::int64_t steps, double* q,
                                [[maybe_unused]] std::int64_t taken = 0) {
    if constexpr (!arm_machine::has_sampled_sensors) {
      group[g]->follow_rows(command, stride, rows, steps, q, 1, taken);
    } else {
      const int first = g * lanes, end = end_of(g);
      for (; rows > 0; --rows, command += stride, q += q ? stride : 0) {
        for (int k = first; k < end; ++k) move_to_machine(k);
        if (steps == 0) group[g]->follow_rows(command, stride, 1, 0, q);
        for (std::int64_t left = steps; left > 0;) {
          std::int64_t chunk = left;  // up to the next tick of one of them
          for (int k = first; k < end; ++k) {
            const std::int64_t period = machine[k]->steps_per_period;
            const std::int64_t due = period - machine[k]->machine.steps() % period;
            if (machine[k]->machine.faulty_joint() < 0 && due < chunk) chunk = due;
          }
          group[g]->follow_rows(command, stride, 1, chunk, q);
          for (int k = first; k < end; ++k) move_to_machine(k), machine[k]->sample_sensors();
          left -= chunk;
        }
      }
    }
  }

  // One servo period under the commands that each takes.
  void exchange(int g, const arm_joint_command* joint, const double* further, std::int64_t tick) {
    const int first = g * lanes, end = end_of(g);
    double given[lanes * N] = {};
    flush_commands(g);
    for (int k = first; k < end; ++k) {
      apply_commands(k, joint + k * J, further ? further + k * Scene::inputs * J : nullptr, tick);
      for (int j = 0; j < N; ++j) given[(k - first) * N + j] = machine[k]->applied[j];
    }
    follow_rows_with_sensors(g, given, 0, 1, steps_per_period, nullptr);
    for (int k = first; k < end; ++k)
      call_in_lane(k, [&](const auto& lanes, int l) {
        for (int j = 0; j < N; ++j) machine[k]->applied[j] = lanes.get_applied_commands(l, j);
      });
    move_shared_to_machines(g);
  }

  // Whether the lanes of a group know all that periods under these commands need.
  bool can_advance_in_lanes(int g, const arm_joint_command* joint) {
    for (int k = g * lanes * J; k < end_of(g) * J; ++k)
      if (!joint[k].enable || joint[k].enable & ARM_CLOSE_BRAKE ||
          joint[k].mode != arm::kModes.at[arm::drive_of<Scene>(k % J)])
        return false;
    return is_driven(*group[g], g);
  }
  // Whether all of its arms are in their lanes, with power and open brakes.
  template <class G>
  bool is_driven([[maybe_unused]] const G& lane_group, [[maybe_unused]] int g) {
    if constexpr (has_signals_in_lanes) {
      if (is_marked_driven(lane_group, g)) return true;
      for (int k = g * lanes; k < end_of(g); ++k) {
        if (!lane_group.is_in_lane(k % lanes) || !machine[k]->powered || users[k]) return false;
        for (int b = 0; b < Scene::brakes; ++b)
          if (machine[k]->machine.is_brake_requested(b) || machine[k]->machine.is_brake_closed(b))
            return false;
      }
      status[g].driven_since = lane_group.exits();
      return true;
    }
    return false;
  }
  bool is_marked_driven(const auto& lane_group, int g) const {
    return status[g].driven_since == lane_group.exits();
  }
  // Periods in lanes, of a group that may, under commands in answer to a tick, in rows of lanes,
  // one per drive; the positions then go to `q` if it is not null. Whether all arms are still there
  // after them. `taken`: steps of the first period, by `advance_in_lanes_to_event`.
  bool advance_in_lanes(int g, const double* given, std::int64_t tick, std::int64_t periods,
                        double* q, std::int64_t taken = 0) {
    if (J == N || !q) {
      group[g]->follow_rows(given, 0, periods, steps_per_period, q, lanes, taken);
    } else {
      double at[lanes * N];
      group[g]->follow_rows(given, 0, periods, steps_per_period, at, lanes, taken);
      write_joints(g, at, q);
    }
    return set_answered(g, given, tick);
  }
  // Take the steps of such a period that come before the first event; whether these were all.
  bool advance_in_lanes_to_event(int g, const double* given, std::int64_t tick, double* q) {
    if constexpr (has_signals_in_lanes) {
      double at[J == N ? 1 : lanes * N];
      double* const positions = J == N || !q ? q : at;
      status[g].taken = group[g]->follow_to_event(given, steps_per_period, positions, lanes);
      if (status[g].taken < steps_per_period) return false;
      if (J != N && q) write_joints(g, at, q);
      status[g].has_applied_commands = status[g].has_pending_commands = true;
      status[g].answered = tick;
      return true;
    }
    return false;
  }
  // Machines whose arms are in their lanes get what was commanded there before they are read.
  bool set_answered(int g, const double* given, std::int64_t tick) {
    status[g].has_applied_commands = true;
    status[g].answered = tick;
    status[g].has_pending_commands = are_in_lanes(g);
    if (!status[g].has_pending_commands) record_commands(g, given, tick);
    return status[g].has_pending_commands;
  }
  // Put down in the machines what their lanes were commanded in answer to a tick.
  void record_commands(int g, const double* given, std::int64_t tick) const {
    status[g].has_pending_commands = false;
    for (int k = g * lanes; k < end_of(g); ++k) {
      machine[k]->answered = tick;
      double (&applied)[N] = machine[k]->applied;
      const auto from_lane = [&](const auto& group, int l) {
        for (int j = 0; j < N; ++j) applied[j] = group.get_applied_commands(l, j);
      };
      if (call_in_lane(k, from_lane)) continue;
      for (int j = 0; j < N; ++j) applied[j] = given[j * lanes + k % lanes];
      machine[k]->machine.clamp_commands(applied);
    }
  }
  // The same with what a group that is in its lanes was commanded last, before a machine is read.
  void flush_commands(int g) const {
    if (status[g].has_pending_commands) record_commands(g, nullptr, status[g].answered);
  }
  std::int64_t answered(int k) const {
    const GroupStatus& group_status = status[k / lanes];
    return group_status.has_pending_commands ? group_status.answered : machine[k]->answered;
  }
  // Periods under held commands. `taken`: steps of the first one, by `hold_commands_to_event`; -1:
  // it has not begun.
  void hold_commands(int g, const arm_joint_command* joint, const double* further,
                     std::int64_t tick, std::int64_t periods, std::int64_t taken = -1) {
    for (; periods > 0 && taken < 0 && !can_advance_in_lanes(g, joint); --periods)
      exchange(g, joint, further, tick);
    if (periods == 0) return;
    double given[lanes * N] = {};
    write_lane_commands(g, joint, given);
    advance_in_lanes(g, given, tick, periods, nullptr, taken < 0 ? 0 : taken);
  }
  // Take the steps of a period that come before the first event; whether these were all.
  bool hold_commands_to_event(int g, const arm_joint_command* joint, std::int64_t tick) {
    status[g].taken = -1;
    if (!can_advance_in_lanes(g, joint)) return false;
    double given[lanes * N] = {};
    write_lane_commands(g, joint, given);
    return advance_in_lanes_to_event(g, given, tick, nullptr);
  }
  // Commands of joints to rows of lanes, one per drive.
  void write_lane_commands(int g, const arm_joint_command* joint, double* given) const {
    for (int k = g * lanes; k < end_of(g); ++k)
      for (int j = 0; j < J; ++j)
        given[arm::drive_of<Scene>(j) * lanes + k % lanes] = joint[k * J + j].value;
  }
  void apply_commands(int k, const arm_joint_command* joint, const double* further,
                      std::int64_t tick) {
    bool stays_in_lane = has_signals_in_lanes && is_in_lane(k);  // its lane bounds what it takes
    for (int b = 0; b < Scene::brakes; ++b)
      stays_in_lane &= machine[k]->is_brake_commanded(b, joint, nullptr) ==
                       machine[k]->machine.is_brake_requested(b);
    if (stays_in_lane) {
      machine[k]->set_commands(joint, further, tick);
    } else {
      move_to_machine(k);
      machine[k]->apply_commands(joint, further, tick);
    }
  }

  // Servo periods of an arm since its reset.
  std::int64_t ticks_of(int k) const {
    std::int64_t steps = 0;
    if (!call_in_lane(k, [&](const auto& group, int l) { steps = group.steps_taken(l); }))
      steps = machine[k]->machine.steps();
    return steps / steps_per_period;
  }

  // Move an arm from its lane to its machine, to be read or changed there.
  void move_to_machine(int k) const {
    flush_commands(k / lanes);
    group[k / lanes]->move_to_machine(k % lanes);
  }
  void move_shared_to_machines(int g) {
    for (int k = g * lanes; k < end_of(g); ++k)
      if (users[k] > 0) move_to_machine(k);
  }
  // act(group, lane) if an arm is in a lane; whether it is.
  template <class Act>
  bool call_in_lane(int k, Act&& act) const {
    return call_in_group_lane(*group[k / lanes], k % lanes, act);
  }
  template <class G, class Act>
  static bool call_in_group_lane([[maybe_unused]] const G& lane_group, [[maybe_unused]] int lane,
                                 [[maybe_unused]] Act&& act) {
    if constexpr (requires { lane_group.is_in_lane(lane); })
      if (lane_group.is_in_lane(lane)) {
        act(lane_group, lane);
        return true;
      }
    return false;
  }
  bool is_in_lane(int k) const {
    return call_in_lane(k, [](const auto&, int) {});
  }
  bool are_in_lanes(int g) const {
    bool all = true;
    for (int k = g * lanes; k < end_of(g); ++k) all = all && is_in_lane(k);
    return all;
  }
  int end_of(int g) const { return (g + 1) * lanes < arms ? (g + 1) * lanes : arms; }

  void measure(int k, arm_measurement* out) const {
    flush_commands(k / lanes);
    const bool done = has_signals_in_lanes && call_in_lane(k, [&](const auto& lanes, int l) {
                        arm_machine::Motors motors;
                        motors.steps = lanes.steps_taken(l);
                        lanes.get_motor_signals(l, motors.current, motors.angle, motors.speed);
                        machine[k]->measure(out, motors);
                      });
    if (done) return;
    move_to_machine(k);
    machine[k]->measure(out);
  }

  void measure(int k, const arm_fleet_measurement& out) const {
    constexpr int M = arm_machine::Sensors::M;
    arm_joint_measurement joint[J];
    arm_measurement measurement = {};
    measurement.size = sizeof measurement;
    measurement.joint = out.joint ? out.joint + k * J : joint;
    measurement.sensors = row_of(out.sensors, k * J);
    measurement.imu = row_of(out.imu, k * M);
    measurement.current_d = row_of(out.current_d, k * J);
    measurement.readings = row_of(out.readings, k * Scene::readings * J);
    measurement.further = row_of(out.further, k * Scene::inputs * J);
    measure(k, &measurement);
    if (out.powered) out.powered[k] = measurement.powered != 0;
    if (out.tick) out.tick[k] = measurement.tick;
    if (out.answered) out.answered[k] = measurement.answered;
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
    if (!get_truth_in_lane(k, truth)) {
      move_to_machine(k);
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
  void observe(int g, const arm_fleet_measurement* measurement,
               const arm_fleet_truth* truth) const {
    if (observe_in_lanes(*group[g], g, measurement, truth)) return;
    for (int k = g * lanes; k < end_of(g); ++k) {
      if (measurement) measure(k, *measurement);
      if (truth) get_truth(k, *truth);
    }
  }
  // The same without the machines; false if more is requested than lanes have.
  template <class G>
  bool observe_in_lanes([[maybe_unused]] const G& lane_group, int g,
                        const arm_fleet_measurement* measurement,
                        const arm_fleet_truth* truth) const {
    if constexpr (has_signals_in_lanes) {
      const bool of_gears = truth && truth->gear_torque;
      if ((truth && (truth->energy || truth->encoder)) || (of_gears && !G::has_gear_torques) ||
          (measurement && measurement->current_d && has_current_d) || !are_in_lanes(g))
        return false;
      alignas(64) double current[N * lanes], angle[N * lanes], speed[N * lanes], rows[2][N * lanes];
      if (measurement || (truth && (truth->current || truth->motor_angle || truth->motor_speed)))
        lane_group.get_motor_signals(current, angle, speed);
      if (measurement) {
        get_applied_commands(lane_group, g, rows[0]);
        write_measurement(lane_group, g, *measurement, current, angle, rows[0]);
      }
      if (!truth) return true;
      lane_group.get_link_motion(rows[0], rows[1]);
      write_rows(g, current, truth->current);
      write_rows(g, angle, truth->motor_angle);
      write_rows(g, speed, truth->motor_speed);
      write_rows(g, rows[0], truth->q);
      write_rows(g, rows[1], truth->v);
      if (of_gears) {
        lane_group.get_gear_torques(rows[0]);
        write_rows(g, rows[0], truth->gear_torque);
      }
      for (int k = g * lanes; k < end_of(g); ++k) {
        if (truth->fault) truth->fault[k] = -1;
        if (truth->time)
          truth->time[k] = static_cast<double>(lane_group.steps_taken(k % lanes)) * step;
      }
      return true;
    }
    return false;
  }
  // Commands that motors got in the newest servo period; lanes also keep those of a run since then.
  void get_applied_commands(const auto& lane_group, int g, double* rows) const {
    if (status[g].has_applied_commands) return lane_group.get_applied_commands(rows);
    for (int k = g * lanes; k < end_of(g); ++k)
      for (int j = 0; j < N; ++j) rows[j * lanes + k % lanes] = machine[k]->applied[j];
  }
  void write_measurement(const auto& lane_group, int g, const arm_fleet_measurement& out,
                         const double* current, const double* angle, const double* applied) const {
    const int first = g * lanes;
    const bool is_open = is_marked_driven(lane_group, g);
    std::int64_t steps = 0, tick = 0;
    for (int k = first; k < end_of(g); ++k) {
      for (int j = 0; out.joint && j < J; ++j) {
        const int drive = arm::drive_of<Scene>(j), at = drive * lanes + k - first;
        arm_joint_measurement& joint = out.joint[k * J + j];
        joint = {arm_machine::counts(drive, angle[at]), current[at], applied[at], 0, 0};
      }
      for (int b = 0; out.joint && !is_open && b < Scene::brakes; ++b)
        out.joint[k * J + Scene::braked[b]].brake = machine[k]->machine.is_brake_closed(b);
      for (int j = 0; out.sensors && j < J; ++j) out.sensors[k * J + j] = {};
      for (int j = 0; out.current_d && j < J; ++j) out.current_d[k * J + j] = 0.0;
      arm_machine::write_deflections(row_of(out.readings, k * Scene::readings * J),
                                     [&](int drive) { return angle[drive * lanes + k - first]; });
      if (out.powered) out.powered[k] = is_open || machine[k]->powered;
      if (out.tick &&
          steps != lane_group.steps_taken(k - first)) {  // mostly that of the arm before
        steps = lane_group.steps_taken(k - first);
        tick = steps / steps_per_period;
      }
      if (out.tick) out.tick[k] = tick;
      if (out.answered) out.answered[k] = answered(k);
    }
  }
  // Rows of lanes to a row of all arms, if it is not null.
  void write_rows(int g, const double* rows, double* to) const {
    for (int k = g * lanes; to && k < end_of(g); ++k)
      for (int j = 0; j < J; ++j) to[k * J + j] = rows[arm::drive_of<Scene>(j) * lanes + k % lanes];
  }
  // Fill in what a lane has without its machine; false if more is requested.
  bool get_truth_in_lane(int k, arm_truth& out) const {
    return !out.energy && !out.gear_torque && call_in_lane(k, [&](const auto& lanes, int l) {
      double row[5][N];
      lanes.get_motor_signals(l, row[0], row[1], row[2]);
      lanes.get_link_motion(l, row[3], row[4]);
      double* const to[] = {out.current, out.motor_angle, out.motor_speed, out.q, out.v};
      for (int r = 0; r < 5; ++r)
        if (to[r]) arm_machine::copy_to_joints(row[r], to[r]);
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
  void set_refused(std::int32_t arm) const { __atomic_store_n(&refused_, arm, __ATOMIC_RELAXED); }

  // OK if check(machine, arm) is for all arms of a mask.
  template <class Check>
  int check_all(const std::uint8_t* mask, Check&& check) const {
    set_refused(-1);
    for (int k = 0; k < arms; ++k)
      if ((!mask || mask[k]) && check(machine[k], k) != ARM_OK) {
        set_refused(k);
        return ARM_REFUSED;
      }
    return ARM_OK;
  }
  template <class Do>
  void change_arms(const std::uint8_t* mask, Do&& act) {
    for (int k = 0; k < arms; ++k)
      if (!mask || mask[k]) move_to_machine(k), act(machine[k], k);
  }

  // The further inputs of commands, null if they have no such rows.
  static const double* further_of(const arm_command& command) {
    return command.size >= sizeof command ? command.further : nullptr;
  }
  // Whether the drives of these arms take these commands.
  bool can_take_commands(std::int32_t first, std::int32_t count, const arm_command* command) const {
    if (!command || command->size < offsetof(arm_command, further) || !command->joint) return false;
    const double* further = further_of(*command);
    for (std::int32_t k = first; k < first + count; ++k)
      if (machine[k]->check_commands(command->joint + k * J,
                                     row_of(further, k * Scene::inputs * J)))
        return false;
    return true;
  }
  int find_result(std::int32_t first, std::int32_t count) const {
    for (std::int32_t k = first; k < first + count; ++k)
      if (!is_in_lane(k) && machine[k]->result() != ARM_OK) return ARM_DIVERGED;
    return ARM_OK;
  }
  // Whether there are so many arms from the first of a group on.
  bool has_arms(std::int32_t first, std::int32_t count) const {
    return first >= 0 && first % lanes == 0 && count >= 0 && first <= arms && count <= arms - first;
  }
  int groups() const { return (arms + lanes - 1) / lanes; }
  // The state of a group, for as long as this lives; kernels read and change arms in its presence.
  struct State : Rows::State {
    State(const arm_fleet& fleet, int g)
        : Rows::State(fleet.rows, *fleet.group[g], g, fleet.common) {}
  };

  // Of a group while all of its arms are in their lanes, where its machines are not read.
  struct GroupStatus {
    std::int64_t driven_since = -1;     // exits from its lanes when it was found driven
    bool has_pending_commands = false;  // its machines do not have the newest commands yet
    std::int64_t answered = -1;         // the tick of these
    bool has_applied_commands = false;  // its lanes do, as no run has commanded them since
    // The members below serve a call that a device carries out period by period.
    bool has_refused = false;  // its control code has
    std::int64_t taken = -1;   // steps of the period before the first event; -1: not begun
    std::int64_t start_ticks[lanes] = {};  // ticks of the arms when the call began
  };

  int arms;
  double step;
  std::int64_t steps_per_period;
  arm_machine** machine;
  std::int32_t* users;  // users of a single arm; while > 0 it leaves its lane after every call
  Group** group;
  GroupStatus* status;
  typename Group::Common common;
  Rows rows;

 private:
  mutable std::int32_t refused_ = -1;
};
