// Machines of one scene that take their steps together, each in a lane of its own.
//
// Together they reach, faster, what each of them reaches alone: a machine whose
// lane does not arrive at a sound state takes the same steps once more by itself, and finds its way
// or its fault as it would without neighbours.
#pragma once

#include "machine/machine.hpp"
#include "schemes/one_thread.hpp"

namespace arm {

template <class S, int width>
class SideBySide {
 public:
  using Machine = arm::Machine<S>;
  static constexpr int N = S::N;

  // At least one machine and at most `width`; they stay where they are.
  SideBySide(double step, Machine* const* machines, int count)
      : h_(step), used_(count), numbers_(machines[0]->numbers_now()), threads_(step, -1, numbers_) {
    for (int lane = 0; lane < used_; ++lane) machine_[lane] = machines[lane];
    for (std::int64_t& edition : editions_) edition = -1;
  }
  SideBySide(const SideBySide&) = delete;

  // Take `steps` steps for each of `rows` rows of commands. A row is of many machines, `stride`
  // numbers long; those of the machines here begin at `command`, one after the other. The positions
  // after each row go to `q` in the same places; a machine at fault stays where it is.
  void follow(const double* command, std::int64_t stride, std::int64_t rows, std::int64_t steps,
              double* q) {
    take_numbers();
    const double* commands[width];
    double* positions[width];
    std::int64_t began[width];
    for (int lane = 0; lane < width; ++lane) {
      commands[lane] = command + (lane < used_ ? lane : 0) * N;
      positions[lane] = lane < used_ ? q + lane * N : nullptr;
      if (lane < used_) began[lane] = machine_[lane]->steps();
    }
    Course course(commands, positions, stride, steps);
    for (std::int64_t left = rows * steps; left > 0;) {
      int count = left < kSection ? static_cast<int>(left) : kSection;
      if constexpr (S::brakes > 0)
        for (int lane = 0; lane < used_; ++lane)
          if (machine_[lane]->steps_to_brakes() < count)
            count = static_cast<int>(machine_[lane]->steps_to_brakes());
      section(course, count);
      left -= count;
      if constexpr (S::brakes > 0) {
        for (int lane = 0; lane < used_; ++lane) machine_[lane]->follow_brakes();
        take_numbers();
      }
    }
    for (int lane = 0; lane < used_; ++lane) {
      std::int64_t row = steps > 0 ? (machine_[lane]->steps() - began[lane]) / steps : 0;
      for (; row < rows; ++row)
        for (int j = 0; j < N; ++j)
          positions[lane][row * stride + j] = machine_[lane]->state().q[j];
    }
  }

 private:
  using X = Lanes<width>;
  using Method = typename MethodOf<S, S::scheme, X>::type;
  using Threads = OneThread<S, Method, X>;
  using Course = arm::Course<S, X, Method::row>;
  using Balance = EnergyBalance<S>;
  using Whole = typename Machine::Whole;

  static constexpr int kSection = 256;  // steps after which each machine has its state again

  // Where all lanes are within a section.
  struct Abreast {
    State<S, X> x;
    alignas(64) X u[Method::row] = {};
    X power = {}, most = {};
    Balance balance[width];
    ExternalWork<S> work[width];
    std::int64_t steps_taken[width];
  };

  void take_numbers() {
    bool renewed = false;
    for (int lane = 0; lane < used_; ++lane) {
      const std::int64_t edition = machine_[lane]->numbers_edition();
      if (edition == editions_[lane]) continue;
      editions_[lane] = edition;
      numbers_.set(lane, machine_[lane]->numbers_now());
      renewed = true;
    }
    if (renewed) threads_.renew();
    if constexpr (S::external_wrench)
      for (int lane = 0; lane < width; ++lane)
        numbers_.set_external_wrenches(lane, numbers_of(lane));
  }

  void section(Course& course, int count) {
    const Course start = course;
    Whole whole[width];
    int sound = -1;  // a lane whose machine is not at fault
    for (int lane = 0; lane < used_; ++lane) {
      whole[lane] = machine_[lane]->whole();
      if (whole[lane].fault < 0) sound = lane;
    }
    if (sound < 0) return;
    Abreast at;
    typename Threads::Memory past = {};
    for (int lane = 0; lane < width; ++lane)
      put(lane, whole[lane < used_ && whole[lane].fault < 0 ? lane : sound].now, at, past);
    threads_.restore(past);

    Mask<X> lost = {};
    for (int left = count; left > 0;) {
      int steps = left;
      for (const std::int64_t taken : at.steps_taken) {
        const int due = Machine::steps_to_check(taken);
        if (due < steps) steps = due;
      }
      march(course, steps, at);
      left -= steps;
      for_each_drive<S>(
          [&](const auto& drive, int j) { lost |= ~Machine::within_bounds(drive, j, at.x, h_); });
      for (int lane = 0; lane < width; ++lane) {
        at.steps_taken[lane] += steps;
        if (lost[lane] || !Machine::is_check(at.steps_taken[lane])) continue;
        if constexpr (S::external_wrench) account_for_work(lane, at);
        if (at.balance[lane].due_after(Machine::kCheckEvery) && !balanced(lane, at))
          lost[lane] = -1;
        else if (left < Machine::kCheckEvery && lane < used_)
          take(lane, at, whole[lane].checked);
      }
    }
    for (int lane = 0; lane < used_; ++lane) {
      if (whole[lane].fault >= 0) continue;
      if (lost[lane]) {
        auto alone = start.template of_lane<Machine::Stepper::row>(lane);
        machine_[lane]->follow(alone, count);
      } else {
        take(lane, at, whole[lane].now);
        machine_[lane]->restore(whole[lane]);
      }
    }
  }

  // Neither inlined nor cloned, as a single machine's steps.
  ARM_APART void march(Course& course, int steps, Abreast& at) {
    State<S, X> y = at.x;
    alignas(64) X u[Method::row];
    for (int j = 0; j < Method::row; ++j) u[j] = at.u[j];
    X power = at.power, most = at.most;
    Mask<X> checked = {};
    for (int lane = 0; lane < width; ++lane)
      if (Machine::is_check(at.steps_taken[lane])) checked[lane] = -1;
    power = select(checked, Balance::largest_power(numbers_, y, u), power);
    course.march(numbers_, threads_, h_, steps, y, u, power, most);
    at.x = y;
    for (int j = 0; j < Method::row; ++j) at.u[j] = u[j];
    at.power = power, at.most = most;
  }

  void account_for_work(int lane, Abreast& at) {
    typename Machine::Instant now = {};
    take(lane, at, now);
    at.most[lane] += at.work[lane].since(numbers_of(lane), now.x);
  }

  const Numbers<S>& numbers_of(int lane) const {
    return machine_[lane < used_ ? lane : 0]->numbers_now();
  }

  // Whether the energy of a lane is one that a machine can have.
  bool balanced(int lane, Abreast& at) {
    typename Machine::Instant now = {};
    take(lane, at, now);
    const int joint = now.balance.broken_by(numbers_of(lane), now.x, h_);
    at.balance[lane] = now.balance;
    at.most[lane] = now.balance.most();
    return joint < 0;
  }

  // All that a lane and a machine's instant have in common, one number after the other.
  static void for_each_number(auto& x, auto& past, auto&& number) {
    arm::for_each_number(x, number);
    past.for_each_number(number);
  }

  static void put(int lane, typename Machine::Instant& now, Abreast& at,
                  typename Threads::Memory& past) {
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

  void take(int lane, Abreast& at, typename Machine::Instant& now) {
    typename Threads::Memory past = threads_.memory();
    double numbers[sizeof now / sizeof(double)];
    double *to = numbers, *from = numbers;
    for_each_number(at.x, past, [&](const X& number) { *to++ = number[lane]; });
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
  Threads threads_;
};

// A machine that has nobody beside it.
template <class S>
class SideBySide<S, 1> {
 public:
  using Machine = arm::Machine<S>;
  static constexpr int N = S::N;

  SideBySide(double, Machine* const* machines, int) : machine_(machines[0]) {}

  void follow(const double* command, std::int64_t stride, std::int64_t rows, std::int64_t steps,
              double* q) {
    for (; rows > 0; --rows, command += stride, q += stride) {
      machine_->advance(command, steps);
      for (int j = 0; j < N; ++j) q[j] = machine_->state().q[j];
    }
  }

 private:
  Machine* machine_;
};

}  // namespace arm
