// Machines of one scene that take their steps in one vector operation, each in a lane of its own.
//
// Results are those of single machines: a machine whose lane does not reach a sound state repeats
// the steps by itself, as without neighbours. One class: its members share the lanes, hence the
// length.
#pragma once

#include "lane_stepper.hpp"
#include "machine/machine.hpp"
#include "schemes/one_thread.hpp"

namespace arm {

// `has_external_state`: their state is not here, but where `set_state` has set it.
template <class S, int width, bool has_external_state = false>
class MachineLanes {
 public:
  using Machine = arm::Machine<S>;
  static constexpr int N = S::N;

  // Tables that all groups of lanes with this step refer to, if their drives are the same.
  struct Common {
    Common(double step, const Numbers<S>& numbers)
        : lanes(numbers), tables(MethodOf<S, Lanes<width>>::make_common(step, lanes)) {}
    Common(const Common&) = delete;

    Numbers<S, Lanes<width>> lanes;
    decltype(MethodOf<S, Lanes<width>>::make_common(0.0, lanes)) tables;
  };

  // At least one machine and at most `width`; they stay where they are, as do the tables.
  MachineLanes(double step, Machine* const* machines, int count, const Common& common)
      : h_(step), used_(count), numbers_(machines[0]->numbers()), state_(begin_state(common)) {
    for (int lane = 0; lane < used_; ++lane) machine_[lane] = machines[lane];
    for (std::int64_t& edition : numbers_versions_) edition = -1;
  }
  MachineLanes(const MachineLanes&) = delete;

  // Take `steps` steps for each of `rows` rows of commands. A row is of many machines, `stride`
  // numbers long. The commands of the machines here begin at `command`, one machine after the
  // other. If a joint's commands are `width` numbers apart, they are side by side for each joint.
  // The positions after each row go
  // to `q`, one machine after the other, if it is not null; a machine at fault keeps its state. The
  // state is in the lanes until `move_to_machine`. `taken`: steps of the first row, by
  // `follow_to_event`.
  void follow_rows(const double* command, std::int64_t stride, std::int64_t rows,
                   std::int64_t steps, double* q, int spacing = 1, std::int64_t taken = 0) {
    if (!all_in_lanes_) update_numbers();
    std::int64_t start_steps[width];
    for (int lane = 0; q && lane < used_; ++lane) start_steps[lane] = steps_taken(lane) - taken;
    CommandSchedule schedule = make_schedule(command, stride, steps, q, spacing, taken);
    for (std::int64_t left = rows * steps - taken; left > 0;) {
      int count = left < kSectionSteps ? static_cast<int>(left) : kSectionSteps;
      const bool stays = all_in_lanes_ && has_idle_brakes_;
      for (int lane = 0; lane < used_ && !stays; ++lane)
        if (const std::int64_t due = count_steps_to_brakes(lane); due < count)
          count = static_cast<int>(due);
      advance_section(schedule, count);
      left -= count;
      if (stays) continue;
      bool changed = false;
      for (int lane = 0; lane < used_; ++lane)
        if (count_steps_to_brakes(lane) <= 0) {
          move_to_machine(lane);
          machine_[lane]->apply_due_brakes();
          changed = true;
        }
      if (changed) update_numbers();
    }
    for (int lane = 0; q && lane < used_; ++lane) {
      if (steps > 0 && in_lane_[lane]) continue;  // the end of all rows
      move_to_machine(lane);
      std::int64_t row = steps > 0 ? (machine_[lane]->steps() - start_steps[lane]) / steps : 0;
      for (; row < rows; ++row)
        for (int j = 0; j < N; ++j) q[lane * N + row * stride + j] = machine_[lane]->state().q[j];
    }
  }
  // Take steps of a row for as long as no machine has to leave its lane or to take one alone.
  // Returns how many: the remaining ones are due by `follow_rows`.
  std::int64_t follow_to_event(const double* command, std::int64_t steps, double* q,
                               int spacing = 1) {
    if (!all_in_lanes_ || !has_idle_brakes_) return 0;
    CommandSchedule schedule = make_schedule(command, 0, steps, q, spacing, 0);
    std::int64_t taken = 0;
    while (taken < steps) {
      const std::int64_t left = steps - taken;
      const int count = left < kSectionSteps ? static_cast<int>(left) : kSectionSteps;
      const int smooth = advance_section<true>(schedule, count);
      taken += smooth;
      if (smooth < count) break;
    }
    return taken;
  }

  // Copy a lane's state to its machine. Call it before the machine is read or changed: lanes keep
  // states between calls of `follow_rows`, since copying in every period would take longer than the
  // period.
  void move_to_machine(int lane) {
    if (!in_lane_[lane]) return;
    read_lane(lane, state().values, state().threads.memory(), full_[lane].now);
    restore_machine(lane);
  }
  bool is_in_lane(int lane) const { return in_lane_[lane]; }

  // State of all lanes, and what takes their steps.
  struct LaneState;
  // A state at rest in the place of the caller; `set_state` it before any other call, if the state
  // is elsewhere.
  LaneState make_state(const Common& common) const { return {h_, numbers_, common}; }
  void set_state(LaneState* state) { state_ = state; }
  // The lane of a machine is there again.
  void set_machines() {
    if constexpr (kHasLaneEvents<S>)
      for (int lane = 0; lane < used_; ++lane)
        state().threads.stepper().set_machine(lane, in_lane_[lane] ? machine_[lane] : nullptr);
  }

  // Times that machines have left their lanes. Between two of these, no number and no brake of a
  // machine in its lane changes.
  std::int64_t exits() const { return exits_; }

  // Of a machine that is in its lane: steps since the reset, commands of the newest step, what
  // Machine::report reports, and the links.
  std::int64_t steps_taken(int lane) const {
    return in_lane_[lane] ? state().values.steps_taken[lane] : machine_[lane]->steps();
  }
  double get_applied_commands(int lane, int j) const { return state().values.u[j][lane]; }
  void get_motor_signals(int lane, double* current, double* angle, double* speed) const {
    machine_[lane]->numbers().for_each_drive([&](const auto& drive, int j) {
      const auto here = input_in_lane(drive, j, state().values.x, X{}, lane);
      current[j] = drive.current(here);
      angle[j] = drive.motor_angle(here);
      speed[j] = drive.motor_speed(here);
    });
  }
  // The same of all lanes, in rows of lanes.
  void get_motor_signals(double* current, double* angle, double* speed) const {
    const auto put = [&](int at, const auto& of_current, const auto& of_angle,
                         const auto& of_speed) {
      __builtin_memcpy(current + at, &of_current, sizeof of_current);
      __builtin_memcpy(angle + at, &of_angle, sizeof of_angle);
      __builtin_memcpy(speed + at, &of_speed, sizeof of_speed);
    };
    const auto put_from = [&](int at, const auto& drive, const auto& here) {
      put(at, drive.current(here), drive.motor_angle(here), drive.motor_speed(here));
    };
    if constexpr (Numbers<S, X>::drives_vary)
      for (int lane = 0; lane < width; ++lane)
        numbers_.for_each_drive_of(lane, [&](const auto& drive, int j) {
          put_from(j * width + lane, drive, input_in_lane(drive, j, state().values.x, X{}, lane));
        });
    else
      numbers_.for_each_drive([&](const auto& drive, int j) {
        put_from(j * width, drive, input_of(drive, j, state().values.x, X{}));
      });
  }
  // The gears' torques on their links, of all lanes, in rows of lanes. Not of rotors that turn with
  // their links, whose accelerations count.
  static constexpr bool has_gear_torques =
      !any_drive<S>([](const auto& drive) { return drive.carries_rotor; });
  void get_gear_torques(double* torque) const {
    for (int lane = 0; lane < width; ++lane)
      numbers_.for_each_drive_of(lane, [&](const auto& drive, int j) {
        torque[j * width + lane] =
            drive.gear_torque(input_in_lane(drive, j, state().values.x, X{}, lane), 0.0);
      });
  }
  void get_applied_commands(double* rows) const { copy_rows(state().values.u, rows); }
  void get_link_motion(double* q, double* v) const {
    copy_rows(state().values.x.q, q), copy_rows(state().values.x.v, v);
  }
  void get_link_motion(int lane, double* q, double* v) const {
    for (int j = 0; j < N; ++j)
      q[j] = state().values.x.q[j][lane], v[j] = state().values.x.v[j][lane];
  }

 private:
  using X = Lanes<width>;
  using Method = std::conditional_t<kHasLaneEvents<S>, LaneStepper<S, X, Machine>, MethodOf<S, X>>;
  using Threads = OneThread<S, Method, X>;
  using CommandSchedule = arm::CommandSchedule<S, X, Method::row>;
  using Balance = EnergyBalance<S>;
  using FullState = typename Machine::FullState;
  using Checkpoint = typename Machine::Checkpoint;

  static void copy_rows(const X* from, double* to) { __builtin_memcpy(to, from, N * sizeof(X)); }

  // See `follow_rows`.
  CommandSchedule make_schedule(const double* command, std::int64_t stride, std::int64_t steps,
                                double* q, int spacing, std::int64_t taken) const {
    const double* commands[width];
    double* positions[width];
    for (int lane = 0; lane < width; ++lane) {
      commands[lane] = command + (lane < used_ ? lane : 0) * (spacing == 1 ? N : 1);
      if (taken > 0) commands[lane] += stride;
      positions[lane] = q && lane < used_ ? q + lane * N : nullptr;
    }
    return {commands, positions, stride, steps, spacing, taken > 0 ? steps - taken : 0};
  }

  static constexpr int kSectionSteps = 256;  // steps after which machines that diverged stand still

  struct LaneValues {
    State<S, X> x;
    alignas(64) X u[Method::row] = {};
    X power = {}, largest_energy = {};
    Balance balance[width];
    ExternalWork<S> work[width];
    std::int64_t steps_taken[width] = {};
  };

 public:
  struct LaneState {
    LaneState(double step, const Numbers<S, X>& numbers, const Common& common)
        : threads(step, -1, numbers, common.tables) {}
    LaneState(const LaneState&) = delete;

    // number(x) for everything that steps change, in a fixed order; x: of all lanes, or of one.
    template <class Number>
    void for_each_number(Number&& number) {
      typename Threads::Memory past = threads.memory();
      for_each_number_of(values, past, number);
      threads.restore(past);
    }
    static int count_words() {
      LaneValues values;
      typename Threads::Memory past = {};
      int words = 0;
      for_each_number_of(values, past, [&](const auto& x) { words += sizeof x / sizeof(double); });
      return words;
    }

    Threads threads;
    LaneValues values;

   private:
    static void for_each_number_of(LaneValues& values, typename Threads::Memory& past,
                                   auto&& number) {
      MachineLanes::for_each_number(values.x, past, number);
      for (int j = 0; j < N; ++j) number(values.u[j]);
      number(values.power), number(values.largest_energy);
      for (int lane = 0; lane < width; ++lane) {
        values.balance[lane].for_each_number(number);
        values.work[lane].for_each_number(number);
        number(values.steps_taken[lane]);
      }
    }
  };

 private:
  struct Snapshot {
    LaneValues values;
    typename Threads::Memory memory;
  };
  auto begin_state([[maybe_unused]] const Common& common) const {
    if constexpr (has_external_state)
      return static_cast<LaneState*>(nullptr);
    else
      return make_state(common);
  }
  LaneState& state() {
    if constexpr (has_external_state)
      return *state_;
    else
      return state_;
  }
  const LaneState& state() const {
    if constexpr (has_external_state)
      return *state_;
    else
      return state_;
  }
  // Lanes that a check has found sound: all of them, or some.
  struct CheckResult {
    bool all_sound, is_sound[width];
  };

  std::int64_t count_steps_to_brakes(int lane) const {
    if (S::brakes == 0) return Brakes<S>::never;
    return in_lane_[lane] ? full_[lane].brakes.next_change() - state().values.steps_taken[lane]
                          : machine_[lane]->count_steps_to_brakes();
  }

  void update_numbers() {
    for (int lane = 0; lane < used_; ++lane) {
      const std::int64_t edition = machine_[lane]->numbers_version();
      if (edition == numbers_versions_[lane]) continue;
      numbers_versions_[lane] = edition;
      numbers_.set(lane, machine_[lane]->numbers());
      state().threads.update_tables(lane);
    }
    if constexpr (S::external_wrench) {
      for (int lane = 0; lane < width; ++lane)
        numbers_.set_external_wrenches(lane, numbers_of(lane));
      if constexpr (kHasLaneEvents<S>) state().threads.stepper().invalidate_links();
    }
  }

  // Copy all sound machines into their lanes; other lanes repeat one of these. False without a
  // sound machine.
  bool move_to_lanes() {
    if (all_in_lanes_) return true;
    typename Threads::Memory past = state().threads.memory();
    int sound = -1;
    bool all = true;
    for (int lane = 0; lane < used_; ++lane) {
      if (!in_lane_[lane]) {
        full_[lane] = machine_[lane]->make_full_state();
        in_lane_[lane] = full_[lane].fault < 0;
        if (in_lane_[lane]) write_lane(lane, full_[lane].now, state().values, past);
      }
      all = all && in_lane_[lane];
      if (in_lane_[lane]) sound = lane;
    }
    set_machines();
    if (sound < 0) return false;
    if (!all || used_ < width) {
      Checkpoint checkpoint = {};
      state().threads.restore(past);
      read_lane(sound, state().values, checkpoint);
      for (int lane = 0; lane < width; ++lane)
        if (lane >= used_ || !in_lane_[lane]) write_lane(lane, checkpoint, state().values, past);
    }
    state().threads.restore(past);
    all_in_lanes_ = all && used_ == width;
    has_idle_brakes_ = true;
    for (int lane = 0; lane < used_; ++lane)
      has_idle_brakes_ = has_idle_brakes_ && full_[lane].brakes.next_change() == Brakes<S>::never;
    return true;
  }

  // A lane's machine goes on by itself from `full_.now`.
  void restore_machine(int lane) {
    if (in_snapshot_[lane])
      read_lane(lane, snapshots_[newest_snapshot_].values, snapshots_[newest_snapshot_].memory,
                full_[lane].checked);
    machine_[lane]->restore(full_[lane]);
    in_lane_[lane] = in_snapshot_[lane] = all_in_lanes_ = false;
    ++exits_;
  }

  // Steps by which time goes on, where each machine takes those alone that are not smooth.
  // `stops_at_event`: up to the first of these. Returns how many were taken.
  template <bool stops_at_event = false>
  int advance_section(CommandSchedule& schedule, int count) {
    if constexpr (!stops_at_event)
      if (!move_to_lanes()) return count;
    const CommandSchedule start = schedule;
    const Snapshot start_snapshot = {state().values, state().threads.memory()};
    Mask<X> diverged = {};    // in what follows
    CheckResult result = {};  // at the newest check
    int left = count;
    for (bool is_smooth = true; is_smooth && left > 0;) {
      int steps = left;
      for (const std::int64_t taken : state().values.steps_taken) {
        const int due = Machine::steps_to_check(taken);
        if (due < steps) steps = due;
      }
      const int taken = advance_steps<stops_at_event>(schedule, steps);
      is_smooth = taken == steps;
      left -= taken;
      for_each_drive<S>([&](const auto& drive, int j) {
        diverged |= ~Machine::is_within_bounds(drive, j, state().values.x, h_);
      });
      bool checks = false;
      for (int lane = 0; lane < width; ++lane) {
        state().values.steps_taken[lane] += taken;
        checks = checks || Machine::is_check(state().values.steps_taken[lane]);
      }
      if (checks && taken > 0) check(stops_at_event ? 0 : left, diverged, result);
    }
    if constexpr (stops_at_event)
      if (any(diverged)) {
        state().values = start_snapshot.values;
        state().threads.restore(start_snapshot.memory);
        return 0;
      }
    for (int lane = 0; lane < used_; ++lane) {
      if (!in_lane_[lane]) continue;
      if (!stops_at_event && diverged[lane]) {
        read_lane(lane, start_snapshot.values, start_snapshot.memory, full_[lane].now);
        restore_machine(lane);
        auto lane_schedule = start.template lane_schedule<Machine::Stepper::row>(lane);
        machine_[lane]->follow_schedule(lane_schedule, count);
      } else if (result.is_sound[lane]) {
        full_[lane].checked = lane_checkpoints_[lane];
        in_snapshot_[lane] = false;
      } else {
        in_snapshot_[lane] = in_snapshot_[lane] || result.all_sound;
      }
    }
    if (result.all_sound) newest_snapshot_ = 1 - newest_snapshot_;
    return count - left;
  }

  // Check the lanes for which that is due; where they are sound is kept, most often for all at
  // once.
  ARM_APART void check(int left, Mask<X>& diverged, CheckResult& result) {
    Mask<X> sound = {};
    for (int lane = 0; lane < width; ++lane) {
      if (diverged[lane] || !Machine::is_check(state().values.steps_taken[lane])) continue;
      if constexpr (S::external_wrench) count_external_work(lane);
      if (state().values.balance[lane].is_due_after(Machine::kCheckEvery) &&
          !has_valid_energy(lane))
        diverged[lane] = -1;
      else
        sound[lane] = -1;
    }
    if (left >= Machine::kCheckEvery) return;
    result.all_sound = all(sound);
    if (result.all_sound) {
      snapshots_[1 - newest_snapshot_] = {state().values, state().threads.memory()};
    } else {
      for (int lane = 0; lane < used_; ++lane)
        if (sound[lane])
          read_lane(lane, state().values, state().threads.memory(), lane_checkpoints_[lane]),
              result.is_sound[lane] = true;
    }
  }

  // Neither inlined nor cloned, as a single machine's steps.
  template <bool stops_at_event = false>
  ARM_APART int advance_steps(CommandSchedule& schedule, int steps) {
    Mask<X> checked = {};
    for (int lane = 0; lane < width; ++lane)
      if (Machine::is_check(state().values.steps_taken[lane])) checked[lane] = -1;
    if (any(checked))
      state().values.power =
          select(checked, Balance::largest_power(numbers_, state().values.x, state().values.u),
                 state().values.power);
    const auto advance = [&](auto& threads) __attribute__((always_inline)) {
      return schedule.advance_steps(numbers_, threads, h_, steps, state().values.x,
                                    state().values.u, state().values.power,
                                    state().values.largest_energy);
    };
    if constexpr (stops_at_event && kHasLaneEvents<S>) {
      SmoothSteps threads = {state().threads};
      return advance(threads);
    } else {
      return advance(state().threads);
    }
  }
  struct SmoothSteps {
    Threads& threads;
    ARM_INLINE bool step(State<S, X>& x, const X (&u)[Method::row]) {
      return threads.stepper().try_smooth_step(x, u, threads);
    }
  };

  void count_external_work(int lane) {
    Checkpoint now = {};
    read_lane(lane, state().values, now);
    state().values.largest_energy[lane] +=
        state().values.work[lane].add_since(numbers_of(lane), now.x);
  }

  const Numbers<S>& numbers_of(int lane) const {
    return machine_[lane < used_ ? lane : 0]->numbers();
  }

  // Whether the energy of a lane is one that a machine can have.
  bool has_valid_energy(int lane) {
    Checkpoint now = {};
    read_lane(lane, state().values, now);
    const int joint = now.balance.find_violation(numbers_of(lane), now.x, h_);
    state().values.balance[lane] = now.balance;
    state().values.largest_energy[lane] = now.balance.energy_limit();
    return joint < 0;
  }

  // Numbers that a lane and a machine's instant share, in order.
  static void for_each_number(auto& x, auto& past, auto&& number) {
    arm::for_each_number(x, number);
    past.for_each_number(number);
  }

  static void write_lane(int lane, Checkpoint& now, LaneValues& values,
                         typename Threads::Memory& past) {
    double numbers[sizeof now / sizeof(double)];
    double *to = numbers, *from = numbers;
    for_each_number(now.x, now.memory, [&](double number) { *to++ = number; });
    for_each_number(values.x, past, [&](X& number) { number[lane] = *from++; });
    for (int j = 0; j < N; ++j) values.u[j][lane] = now.u[j];
    values.power[lane] = now.power;
    values.largest_energy[lane] = now.balance.energy_limit();
    values.balance[lane] = now.balance;
    values.work[lane] = now.work;
    values.steps_taken[lane] = now.steps_taken;
  }

  void read_lane(int lane, const LaneValues& values, Checkpoint& now) const {
    read_lane(lane, values, state().threads.memory(), now);
  }
  static void read_lane(int lane, const LaneValues& values, const typename Threads::Memory& past,
                        Checkpoint& now) {
    double numbers[sizeof now / sizeof(double)];
    double *to = numbers, *from = numbers;
    // Only read here.
    for_each_number(const_cast<State<S, X>&>(values.x), const_cast<typename Threads::Memory&>(past),
                    [&](const X& number) { *to++ = number[lane]; });
    for_each_number(now.x, now.memory, [&](double& number) { number = *from++; });
    for (int j = 0; j < N; ++j) now.u[j] = values.u[j][lane];
    now.power = values.power[lane];
    now.balance = values.balance[lane];
    now.balance.set_energy_limit(values.largest_energy[lane]);
    now.work = values.work[lane];
    now.steps_taken = values.steps_taken[lane];
  }

  double h_;
  int used_;
  Machine* machine_[width];
  std::int64_t numbers_versions_[width];  // of the numbers that are in use; none are at first
  Numbers<S, X> numbers_;
  std::conditional_t<has_external_state, LaneState*, LaneState> state_;
  bool in_lane_[width] = {};      // whether the state is in the lane; else in the machine
  bool all_in_lanes_ = false;     // all lanes are in use, and as `move_to_lanes` left them
  bool has_idle_brakes_ = false;  // none of their brakes is about to change
  std::int64_t exits_ = 0;
  FullState full_[width];  // of machines in lanes; `now` is that of the time when they came
  // Where lanes were found sound last: `in_snapshot_`, or in `full_`.
  Snapshot snapshots_[2] = {};
  int newest_snapshot_ = 0;
  bool in_snapshot_[width] = {};
  Checkpoint lane_checkpoints_[width] = {};
};

// A single machine.
template <class S, bool has_external_state>
class MachineLanes<S, 1, has_external_state> {
 public:
  using Machine = arm::Machine<S>;
  static constexpr int N = S::N;

  struct Common {
    Common(double, const Numbers<S>&) {}
  };
  MachineLanes(double, Machine* const* machines, int, const Common&) : machine_(machines[0]) {}

  void follow_rows(const double* command, std::int64_t stride, std::int64_t rows,
                   std::int64_t steps, double* q, int = 1, std::int64_t = 0) {
    for (; rows > 0; --rows, command += stride) {
      machine_->advance(command, steps);
      if (!q) continue;
      for (int j = 0; j < N; ++j) q[j] = machine_->state().q[j];
      q += stride;
    }
  }
  std::int64_t follow_to_event(const double*, std::int64_t, double*, int = 1) { return 0; }
  void move_to_machine(int) {}

 private:
  Machine* machine_;
};

}  // namespace arm
