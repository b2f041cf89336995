// Machines of one scene that take their steps together, each in a lane of its own.
//
// Results are those of single machines: a machine whose lane does not reach a sound state repeats
// the steps alone, as without neighbours.
#pragma once

#include "lane_drives.hpp"
#include "machine/machine.hpp"
#include "schemes/one_thread.hpp"

namespace arm {

// `elsewhere`: their state is not here, but where `use` has set it.
template <class S, int width, bool elsewhere = false>
class SideBySide {
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
  SideBySide(double step, Machine* const* machines, int count, const Common& common)
      : h_(step), used_(count), numbers_(machines[0]->numbers_now()), state_(begin_state(common)) {
    for (int lane = 0; lane < used_; ++lane) machine_[lane] = machines[lane];
    for (std::int64_t& edition : editions_) edition = -1;
  }
  SideBySide(const SideBySide&) = delete;

  // Take `steps` steps for each of `rows` rows of commands. A row is of many machines, `stride`
  // numbers long; those of the machines here begin at `command`, one after the other, or side by
  // side for each joint, if its commands are `width` numbers apart. The positions after each row go
  // to `q`, one machine after the other, if it is not null; a machine at fault keeps its state. The
  // state is in the lanes until `settle`. `taken`: steps of the first row, by `follow_smoothly`.
  void follow(const double* command, std::int64_t stride, std::int64_t rows, std::int64_t steps,
              double* q, int apart = 1, std::int64_t taken = 0) {
    if (!together_) take_numbers();
    std::int64_t began[width];
    for (int lane = 0; q && lane < used_; ++lane) began[lane] = steps_taken(lane) - taken;
    CommandSchedule schedule = make_schedule(command, stride, steps, q, apart, taken);
    for (std::int64_t left = rows * steps - taken; left > 0;) {
      int count = left < kSection ? static_cast<int>(left) : kSection;
      const bool still = together_ && brakes_rest_;
      for (int lane = 0; lane < used_ && !still; ++lane)
        if (const std::int64_t due = steps_to_brakes(lane); due < count)
          count = static_cast<int>(due);
      section(schedule, count);
      left -= count;
      if (still) continue;
      bool changed = false;
      for (int lane = 0; lane < used_; ++lane)
        if (steps_to_brakes(lane) <= 0) {
          settle(lane);
          machine_[lane]->follow_brakes();
          changed = true;
        }
      if (changed) take_numbers();
    }
    for (int lane = 0; q && lane < used_; ++lane) {
      if (steps > 0 && abreast_[lane]) continue;  // the end of all rows
      settle(lane);
      std::int64_t row = steps > 0 ? (machine_[lane]->steps() - began[lane]) / steps : 0;
      for (; row < rows; ++row)
        for (int j = 0; j < N; ++j) q[lane * N + row * stride + j] = machine_[lane]->state().q[j];
    }
  }
  // Take steps of a row for as long as no machine has to leave its lane or to take one alone.
  // Returns how many: the remaining ones are due by `follow`.
  std::int64_t follow_smoothly(const double* command, std::int64_t steps, double* q,
                               int apart = 1) {
    if (!together_ || !brakes_rest_) return 0;
    CommandSchedule schedule = make_schedule(command, 0, steps, q, apart, 0);
    std::int64_t taken = 0;
    while (taken < steps) {
      const std::int64_t left = steps - taken;
      const int count = left < kSection ? static_cast<int>(left) : kSection;
      const int some = section<true>(schedule, count);
      taken += some;
      if (some < count) break;
    }
    return taken;
  }

  // Copy a lane's state to its machine. Call it before the machine is read or changed: lanes keep
  // states between calls of `follow`, since copying in every period would take longer than the
  // period.
  void settle(int lane) {
    if (!abreast_[lane]) return;
    take(lane, state().at, state().threads.memory(), full_[lane].now);
    leave(lane);
  }
  bool is_abreast(int lane) const { return abreast_[lane]; }

  // State of all lanes, and what takes their steps.
  struct LaneState;
  // A state at rest in the place of the caller; `use` it before any other call, if the state is
  // elsewhere.
  LaneState make_state(const Common& common) const { return {h_, numbers_, common}; }
  void use(LaneState* state) { state_ = state; }
  // The lane of a machine is there again.
  void put_machines() {
    if constexpr (kStepsApart<S>)
      for (int lane = 0; lane < used_; ++lane)
        state().threads.stepper().put(lane, abreast_[lane] ? machine_[lane] : nullptr);
  }

  // Times that machines have left their lanes. Between two of these, no number and no brake of a
  // machine in its lane changes.
  std::int64_t departures() const { return departures_; }

  // Of a machine that is in its lane: steps since the reset, commands of the newest step, what
  // Machine::report reports, and the links.
  std::int64_t steps_taken(int lane) const {
    return abreast_[lane] ? state().at.steps_taken[lane] : machine_[lane]->steps();
  }
  double applied(int lane, int j) const { return state().at.u[j][lane]; }
  void report(int lane, double* current, double* angle, double* speed) const {
    machine_[lane]->numbers_now().for_each_drive([&](const auto& drive, int j) {
      const auto here = input_in_lane(drive, j, state().at.x, X{}, lane);
      current[j] = drive.current(here);
      angle[j] = drive.motor_angle(here);
      speed[j] = drive.motor_speed(here);
    });
  }
  // The same of all lanes, in rows of lanes.
  void report(double* current, double* angle, double* speed) const {
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
          put_from(j * width + lane, drive, input_in_lane(drive, j, state().at.x, X{}, lane));
        });
    else
      numbers_.for_each_drive([&](const auto& drive, int j) {
        put_from(j * width, drive, input_of(drive, j, state().at.x, X{}));
      });
  }
  // The gears' torques on their links, of all lanes, in rows of lanes. Not of rotors that turn with
  // their links, whose accelerations count.
  static constexpr bool has_gear_torques =
      !any_drive<S>([](const auto& drive) { return drive.carries_rotor; });
  void gear_torques(double* torque) const {
    for (int lane = 0; lane < width; ++lane)
      numbers_.for_each_drive_of(lane, [&](const auto& drive, int j) {
        torque[j * width + lane] =
            drive.gear_torque(input_in_lane(drive, j, state().at.x, X{}, lane), 0.0);
      });
  }
  void applied(double* rows) const { put_rows(state().at.u, rows); }
  void links(double* q, double* v) const {
    put_rows(state().at.x.q, q), put_rows(state().at.x.v, v);
  }
  void links(int lane, double* q, double* v) const {
    for (int j = 0; j < N; ++j) q[j] = state().at.x.q[j][lane], v[j] = state().at.x.v[j][lane];
  }

 private:
  using X = Lanes<width>;
  using Method = std::conditional_t<kStepsApart<S>, SmoothTogether<S, X, Machine>, MethodOf<S, X>>;
  using Threads = OneThread<S, Method, X>;
  using CommandSchedule = arm::CommandSchedule<S, X, Method::row>;
  using Balance = EnergyBalance<S>;
  using FullState = typename Machine::FullState;
  using Checkpoint = typename Machine::Checkpoint;

  static void put_rows(const X* from, double* to) { __builtin_memcpy(to, from, N * sizeof(X)); }

  // See `follow`.
  CommandSchedule make_schedule(const double* command, std::int64_t stride, std::int64_t steps,
                                double* q, int apart, std::int64_t taken) const {
    const double* commands[width];
    double* positions[width];
    for (int lane = 0; lane < width; ++lane) {
      commands[lane] = command + (lane < used_ ? lane : 0) * (apart == 1 ? N : 1);
      if (taken > 0) commands[lane] += stride;
      positions[lane] = q && lane < used_ ? q + lane * N : nullptr;
    }
    return {commands, positions, stride, steps, apart, taken > 0 ? steps - taken : 0};
  }

  static constexpr int kSection = 256;  // steps after which machines that diverged stand still

  struct Abreast {
    State<S, X> x;
    alignas(64) X u[Method::row] = {};
    X power = {}, most = {};
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
      for_each_number_of(at, past, number);
      threads.restore(past);
    }
    static int count_words() {
      Abreast at;
      typename Threads::Memory past = {};
      int words = 0;
      for_each_number_of(at, past, [&](const auto& x) { words += sizeof x / sizeof(double); });
      return words;
    }

    Threads threads;
    Abreast at;

   private:
    static void for_each_number_of(Abreast& at, typename Threads::Memory& past, auto&& number) {
      SideBySide::for_each_number(at.x, past, number);
      for (int j = 0; j < N; ++j) number(at.u[j]);
      number(at.power), number(at.most);
      for (int lane = 0; lane < width; ++lane) {
        at.balance[lane].for_each_number(number);
        at.work[lane].for_each_number(number);
        number(at.steps_taken[lane]);
      }
    }
  };

 private:
  struct Moment {
    Abreast at;
    typename Threads::Memory past;
  };
  auto begin_state([[maybe_unused]] const Common& common) const {
    if constexpr (elsewhere)
      return static_cast<LaneState*>(nullptr);
    else
      return make_state(common);
  }
  LaneState& state() {
    if constexpr (elsewhere)
      return *state_;
    else
      return state_;
  }
  const LaneState& state() const {
    if constexpr (elsewhere)
      return *state_;
    else
      return state_;
  }
  // Lanes that a check has found sound: all of them, or some.
  struct Found {
    bool all, alone[width];
  };

  std::int64_t steps_to_brakes(int lane) const {
    if (S::brakes == 0) return Brakes<S>::never;
    return abreast_[lane] ? full_[lane].brakes.next() - state().at.steps_taken[lane]
                          : machine_[lane]->steps_to_brakes();
  }

  void take_numbers() {
    for (int lane = 0; lane < used_; ++lane) {
      const std::int64_t edition = machine_[lane]->numbers_edition();
      if (edition == editions_[lane]) continue;
      editions_[lane] = edition;
      numbers_.set(lane, machine_[lane]->numbers_now());
      state().threads.renew(lane);
    }
    if constexpr (S::external_wrench) {
      for (int lane = 0; lane < width; ++lane)
        numbers_.set_external_wrenches(lane, numbers_of(lane));
      if constexpr (kStepsApart<S>) state().threads.stepper().forget_links();
    }
  }

  // Copy all sound machines into their lanes; other lanes repeat one of these. False without a
  // sound machine.
  bool line_up() {
    if (together_) return true;
    typename Threads::Memory past = state().threads.memory();
    int sound = -1;
    bool all = true;
    for (int lane = 0; lane < used_; ++lane) {
      if (!abreast_[lane]) {
        full_[lane] = machine_[lane]->full_state();
        abreast_[lane] = full_[lane].fault < 0;
        if (abreast_[lane]) put(lane, full_[lane].now, state().at, past);
      }
      all = all && abreast_[lane];
      if (abreast_[lane]) sound = lane;
    }
    put_machines();
    if (sound < 0) return false;
    if (!all || used_ < width) {
      Checkpoint one = {};
      state().threads.restore(past);
      take(sound, state().at, one);
      for (int lane = 0; lane < width; ++lane)
        if (lane >= used_ || !abreast_[lane]) put(lane, one, state().at, past);
    }
    state().threads.restore(past);
    together_ = all && used_ == width;
    brakes_rest_ = true;
    for (int lane = 0; lane < used_; ++lane)
      brakes_rest_ = brakes_rest_ && full_[lane].brakes.next() == Brakes<S>::never;
    return true;
  }

  // A lane's machine goes on by itself from `full_.now`.
  void leave(int lane) {
    if (kept_[lane]) take(lane, checked_[newest_].at, checked_[newest_].past, full_[lane].checked);
    machine_[lane]->restore(full_[lane]);
    abreast_[lane] = kept_[lane] = together_ = false;
    ++departures_;
  }

  // Steps by which time goes on, where each machine takes those alone that are not smooth.
  // `smoothly`: up to the first of these. Returns how many were taken.
  template <bool smoothly = false>
  int section(CommandSchedule& schedule, int count) {
    if constexpr (!smoothly)
      if (!line_up()) return count;
    const CommandSchedule start = schedule;
    const Moment began = {state().at, state().threads.memory()};
    Mask<X> lost = {};  // in what follows
    Found found = {};   // at the newest check
    int left = count;
    for (bool goes_on = true; goes_on && left > 0;) {
      int steps = left;
      for (const std::int64_t taken : state().at.steps_taken) {
        const int due = Machine::steps_to_check(taken);
        if (due < steps) steps = due;
      }
      const int taken = march<smoothly>(schedule, steps);
      goes_on = taken == steps;
      left -= taken;
      for_each_drive<S>([&](const auto& drive, int j) {
        lost |= ~Machine::within_bounds(drive, j, state().at.x, h_);
      });
      bool checks = false;
      for (int lane = 0; lane < width; ++lane) {
        state().at.steps_taken[lane] += taken;
        checks = checks || Machine::is_check(state().at.steps_taken[lane]);
      }
      if (checks && taken > 0) check(smoothly ? 0 : left, lost, found);
    }
    if constexpr (smoothly)
      if (any(lost)) {
        state().at = began.at;
        state().threads.restore(began.past);
        return 0;
      }
    for (int lane = 0; lane < used_; ++lane) {
      if (!abreast_[lane]) continue;
      if (!smoothly && lost[lane]) {
        take(lane, began.at, began.past, full_[lane].now);
        leave(lane);
        auto alone = start.template of_lane<Machine::Stepper::row>(lane);
        machine_[lane]->follow(alone, count);
      } else if (found.alone[lane]) {
        full_[lane].checked = alone_[lane];
        kept_[lane] = false;
      } else {
        kept_[lane] = kept_[lane] || found.all;
      }
    }
    if (found.all) newest_ = 1 - newest_;
    return count - left;
  }

  // Check the lanes for which that is due; where they are sound is kept, most often for all at
  // once.
  ARM_APART void check(int left, Mask<X>& lost, Found& found) {
    Mask<X> sound = {};
    for (int lane = 0; lane < width; ++lane) {
      if (lost[lane] || !Machine::is_check(state().at.steps_taken[lane])) continue;
      if constexpr (S::external_wrench) account_for_work(lane);
      if (state().at.balance[lane].due_after(Machine::kCheckEvery) && !balanced(lane))
        lost[lane] = -1;
      else
        sound[lane] = -1;
    }
    if (left >= Machine::kCheckEvery) return;
    found.all = all(sound);
    if (found.all) {
      checked_[1 - newest_] = {state().at, state().threads.memory()};
    } else {
      for (int lane = 0; lane < used_; ++lane)
        if (sound[lane])
          take(lane, state().at, state().threads.memory(), alone_[lane]), found.alone[lane] = true;
    }
  }

  // Neither inlined nor cloned, as a single machine's steps.
  template <bool smoothly = false>
  ARM_APART int march(CommandSchedule& schedule, int steps) {
    Mask<X> checked = {};
    for (int lane = 0; lane < width; ++lane)
      if (Machine::is_check(state().at.steps_taken[lane])) checked[lane] = -1;
    if (any(checked))
      state().at.power = select(
          checked, Balance::largest_power(numbers_, state().at.x, state().at.u), state().at.power);
    const auto go = [&](auto& threads) __attribute__((always_inline)) {
      return schedule.march(numbers_, threads, h_, steps, state().at.x, state().at.u,
                            state().at.power, state().at.most);
    };
    if constexpr (smoothly && kStepsApart<S>) {
      SmoothSteps threads = {state().threads};
      return go(threads);
    } else {
      return go(state().threads);
    }
  }
  struct SmoothSteps {
    Threads& threads;
    ARM_INLINE bool step(State<S, X>& x, const X (&u)[Method::row]) {
      return threads.stepper().step_smoothly(x, u, threads);
    }
  };

  void account_for_work(int lane) {
    Checkpoint now = {};
    take(lane, state().at, now);
    state().at.most[lane] += state().at.work[lane].since(numbers_of(lane), now.x);
  }

  const Numbers<S>& numbers_of(int lane) const {
    return machine_[lane < used_ ? lane : 0]->numbers_now();
  }

  // Whether the energy of a lane is one that a machine can have.
  bool balanced(int lane) {
    Checkpoint now = {};
    take(lane, state().at, now);
    const int joint = now.balance.broken_by(numbers_of(lane), now.x, h_);
    state().at.balance[lane] = now.balance;
    state().at.most[lane] = now.balance.most();
    return joint < 0;
  }

  // Numbers that a lane and a machine's instant share, in order.
  static void for_each_number(auto& x, auto& past, auto&& number) {
    arm::for_each_number(x, number);
    past.for_each_number(number);
  }

  static void put(int lane, Checkpoint& now, Abreast& at, typename Threads::Memory& past) {
    double numbers[sizeof now / sizeof(double)];
    double *to = numbers, *from = numbers;
    for_each_number(now.x, now.past, [&](double number) { *to++ = number; });
    for_each_number(at.x, past, [&](X& number) { number[lane] = *from++; });
    for (int j = 0; j < N; ++j) at.u[j][lane] = now.u[j];
    at.power[lane] = now.power;
    at.most[lane] = now.balance.most();
    at.balance[lane] = now.balance;
    at.work[lane] = now.work;
    at.steps_taken[lane] = now.steps_taken;
  }

  void take(int lane, const Abreast& at, Checkpoint& now) const {
    take(lane, at, state().threads.memory(), now);
  }
  static void take(int lane, const Abreast& at, const typename Threads::Memory& past,
                   Checkpoint& now) {
    double numbers[sizeof now / sizeof(double)];
    double *to = numbers, *from = numbers;
    // Only read here.
    for_each_number(const_cast<State<S, X>&>(at.x), const_cast<typename Threads::Memory&>(past),
                    [&](const X& number) { *to++ = number[lane]; });
    for_each_number(now.x, now.past, [&](double& number) { number = *from++; });
    for (int j = 0; j < N; ++j) now.u[j] = at.u[j][lane];
    now.power = at.power[lane];
    now.balance = at.balance[lane];
    now.balance.allow(at.most[lane]);
    now.work = at.work[lane];
    now.steps_taken = at.steps_taken[lane];
  }

  double h_;
  int used_;
  Machine* machine_[width];
  std::int64_t editions_[width];  // of the numbers that are in use; none are at first
  Numbers<S, X> numbers_;
  std::conditional_t<elsewhere, LaneState*, LaneState> state_;
  bool abreast_[width] = {};  // whether the state is in the lane; else in the machine
  bool together_ = false;     // all lanes are in use, and as `line_up` left them
  bool brakes_rest_ = false;  // none of their brakes is about to change
  std::int64_t departures_ = 0;
  FullState full_[width];  // of machines in lanes; `now` is that of the time when they came
  // Where lanes were found sound last: `kept_`, or in `full_`.
  Moment checked_[2] = {};
  int newest_ = 0;
  bool kept_[width] = {};
  Checkpoint alone_[width] = {};
};

// A single machine.
template <class S, bool elsewhere>
class SideBySide<S, 1, elsewhere> {
 public:
  using Machine = arm::Machine<S>;
  static constexpr int N = S::N;

  struct Common {
    Common(double, const Numbers<S>&) {}
  };
  SideBySide(double, Machine* const* machines, int, const Common&) : machine_(machines[0]) {}

  void follow(const double* command, std::int64_t stride, std::int64_t rows, std::int64_t steps,
              double* q, int = 1, std::int64_t = 0) {
    for (; rows > 0; --rows, command += stride) {
      machine_->advance(command, steps);
      if (!q) continue;
      for (int j = 0; j < N; ++j) q[j] = machine_->state().q[j];
      q += stride;
    }
  }
  std::int64_t follow_smoothly(const double*, std::int64_t, double*, int = 1) { return 0; }
  void settle(int) {}

 private:
  Machine* machine_;
};

}  // namespace arm
