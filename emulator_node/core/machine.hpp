// The machine: motors, gears and links of one scene, and their way through time.
#pragma once

#include <cstdint>
#include <type_traits>

#include "energy.hpp"
#include "energy_flow.hpp"
#include "finite.hpp"
#include "linearly_implicit.hpp"
#include "located.hpp"
#include "paper_scheme.hpp"

namespace arm {

template <class S>
class Machine {
 public:
  static constexpr int N = S::N;

  static constexpr bool locates = S::events == Events::located && Modes<S>::present;
  using Method = typename MethodOf<S, S::scheme>::type;
  using Stepper = std::conditional_t<locates, Located<S>, Method>;

  using Threads = typename S::template Threads<Stepper>;

  // `core`: of the second thread, if there is one; -1: any.
  // `parameters`: values of the varied numbers.
  Machine(double dt, int core, const double* parameters)
      : h(dt), numbers(parameters), threads(dt, core, numbers) {}

  // Schedule all threads as the calling one; false if the system does not permit it.
  bool join_schedule() { return threads.join_schedule(); }

  // All that decides how a machine goes on from one instant.
  struct Instant {
    State<S> x;
    typename Threads::Memory past;
    EnergyBalance<S> balance;
    double u[Stepper::row];  // the commands of the step before, within the supply
    double power;            // W, that the motors are given at most
    std::int64_t steps_taken;

    // number(x) for all that it is, in a fixed order.
    template <class Number>
    void for_each_number(Number&& number) {
      arm::for_each_number(x, number);
      past.for_each_number(number);
      balance.for_each_number(number);
      for (int j = 0; j < N; ++j) number(u[j]);
      number(power);
      number(steps_taken);
    }
  };
  // And where it goes back to when the energy says that it has been none.
  struct Whole {
    Instant now, checked;
    std::int64_t fault;

    template <class Number>
    void for_each_number(Number&& number) {
      now.for_each_number(number);
      checked.for_each_number(number);
      number(fault);
    }
  };

  Whole whole() const { return {instant(), checked, fault}; }
  void restore(const Whole& whole) {
    go_back(whole.now);
    checked = whole.checked;
    fault = static_cast<int>(whole.fault);
  }

  // Set a varied number, between two steps. The motion goes on from where it is.
  void set_parameter(int k, double value) {
    const typename Threads::Memory past = threads.memory();
    numbers.set(k, value);
    threads.renew();
    threads.restore(past);
    balance.reset(numbers, x);
    power = EnergyBalance<S>::largest_power(numbers, x, applied);
    checked = instant();
  }
  double parameter(int k) const { return numbers.value(k); }
  const Numbers<S>& numbers_now() const { return numbers; }

  // Put the machine at a state without a past. Time goes on, or begins anew at 0.
  void put(const State<S>& at, bool anew) {
    x = at;
    threads.reset(x);
    balance.reset(numbers, x);
    fault = -1;
    for (double& u : applied) u = 0.0;
    power = EnergyBalance<S>::largest_power(numbers, x, applied);
    if (anew) steps_taken = 0;
    checked = instant();
  }

  // Put the links at (q, v) at time 0, the motors along with them: no current, gears unloaded.
  void reset(const double* q, const double* v) {
    State<S> at = {};
    numbers.for_each_drive([&](const auto& drive, int j) {
      const auto behind = drive.at_rest_behind(q[j], v[j]);
      for (int k = 0; k < drive.states; ++k) at.z[k][j] = behind.z[k];
      at.q[j] = q[j];
      at.v[j] = v[j];
    });
    put(at, true);
  }

  // Take `steps` steps with the voltages held, clamped to the supply. Returns -1, or the joint that
  // went out of bounds: then the state is the last one within, until reset.
  int advance(const double* voltage, std::int64_t steps) {
    double q[N];
    return follow(voltage, 1, steps, q);
  }

  // The same for `rows` rows of voltages. The links' positions after each row go to `q`.
  int follow(const double* voltage, std::int64_t rows, std::int64_t steps, double* q) {
    if (fault >= 0) return fault;
    Course course = {voltage, q, steps, 0};
    std::int64_t count = rows * steps;
    if (steps == 0)
      for (std::int64_t row = 0; row < rows; ++row) course.end_row(x);
    threads.begin(count, x);
    while (count > 0) {
      // Up to the next check, which is due after so many steps since the reset, whoever took them.
      const int due = kCheckEvery - static_cast<int>(steps_taken % kCheckEvery);
      const int chunk = count < due ? static_cast<int>(count) : due;
      const Instant before = instant();
      const Course course_before = course;
      run(course, chunk);
      if (joint_out_of_bounds(x) >= 0) {
        go_back(before);
        return fault = creep_to_the_fault(course_before, chunk);
      }
      count -= chunk;
      if (chunk < due) continue;
      fault = balance.broken_by(numbers, x, kCheckEvery, h);
      if (fault >= 0) {
        go_back(checked);
        return fault;
      }
      checked = instant();
    }
    threads.end();
    return -1;
  }

  // The same as `advance`. What the joints are given and dissipate [J] is added to `flow`.
  int advance_metered(const double* voltage, std::int64_t steps, EnergyFlow<S>& flow) {
    EnergyMeter<S> meter(numbers);
    double u[Stepper::row] = {};
    for (int j = 0; j < N; ++j) u[j] = clamp(voltage[j], S::supply_voltage);
    if constexpr (locates) threads.watch(&meter);
    int joint = fault;
    for (; joint < 0 && steps > 0; --steps) {
      const State<S> before = x;
      joint = advance(voltage, 1);
      if constexpr (!locates)
        if (joint < 0) meter.part(before, x, u, modes_at(before, u), h);
    }
    if constexpr (locates) threads.watch(static_cast<EnergyMeter<S>*>(nullptr));
    flow.add(meter.total, 1.0);
    return joint;
  }

  // What the joints are given and dissipate now, under these voltages [W].
  EnergyFlow<S> powers(const double* voltage) const {
    double u[N];
    for (int j = 0; j < N; ++j) u[j] = clamp(voltage[j], S::supply_voltage);
    State<S> at = x;
    Modes<S>::settle_currents(numbers, at, u);
    return powers_of(numbers, at, u, modes_at(at, u));
  }

  std::int64_t steps() const { return steps_taken; }
  double time() const { return static_cast<double>(steps_taken) * h; }
  int faulty_joint() const { return fault; }
  const State<S>& state() const { return x; }

  // Current [A], angle [rad] and speed [rad/s] of each motor.
  void report(double* current, double* angle, double* speed) const {
    numbers.for_each_drive([&](const auto& drive, int j) {
      const auto at = input_of(drive, j, x, 0.0);
      current[j] = drive.current(at);
      angle[j] = drive.motor_angle(at);
      speed[j] = drive.motor_speed(at);
    });
  }

  // Torque that each gear puts on its link [N m]; a rigid gear's is what is left for the link when
  // the motor has accelerated its rotor.
  void gear_torques(double* T) const {
    double a[N] = {};
    if constexpr (any_drive<S>([](const auto& drive) { return drive.carries_rotor; })) {
      typename Links<S>::Dynamics links;
      Links<S>::dynamics_apart(numbers, x.q, x.v, links);
      numbers.for_each_drive([&](const auto& drive, int j) {
        links.M.at[j][j] += drive.carried();
        a[j] = drive.rates(input_of(drive, j, x, 0.0), false).g - links.nle[j];
      });
      Coulomb<S, double>(numbers).solve(links.M.at, x.v, a);
    }
    numbers.for_each_drive([&](const auto& drive, int j) {
      T[j] = drive.gear_torque(input_of(drive, j, x, 0.0), a[j]);
    });
  }

  // Kinetic, potential, elastic and magnetic energy of links, gears and motors [J].
  double energy() const { return energy_of<S>(numbers, x).total(); }

 private:
  Modes<S> modes_at(State<S> x, const double* u) const {
    typename Links<S>::Dynamics links;
    Links<S>::dynamics_apart(numbers, x.q, x.v, links);
    Modes<S>::settle_currents(numbers, x, u);
    return Modes<S>(numbers, x, u, links);
  }

  static constexpr int kCheckEvery = 16;
  static constexpr double kLargestTurn = 3.14159265358979;  // rad (or m) in one step

  // What is to be done: rows of voltages, each for some steps.
  struct Course {
    const double* command;  // of the next row
    double* q;              // for the positions after this row
    std::int64_t steps;     // of a row
    std::int64_t left;      // of this row

    // True if the commands, within the supply, differ from those before.
    ARM_INLINE bool begin_row(double (&u)[Stepper::row]) {
      bool differ = false;
      for_each<N>([&](auto j) __attribute__((always_inline)) {
        const double wanted = clamp(command[j], S::supply_voltage);
        differ |= wanted != u[j];
        u[j] = wanted;
      });
      command += N;
      return differ;
    }
    ARM_INLINE void end_row(const State<S>& x) {
      for_each<N>([&](auto j) __attribute__((always_inline)) { q[j] = x.q[j]; });
      q += N;
    }
  };

  // Neither inlined nor cloned: every step, however it is asked for, runs the same instructions and
  // gives the same bits.
  __attribute__((noinline, noclone)) void run(Course& course, int count) {
    State<S> y = x;  // here, as what follows, where the compiler may keep it in registers
    alignas(64) double u[Stepper::row];
    for (int j = 0; j < Stepper::row; ++j) u[j] = applied[j];
    std::int64_t left = course.left;
    double most = balance.most(), given = h * power;
    const auto look_at_power = [&] {
      power = EnergyBalance<S>::largest_power(numbers, y, u);
      given = h * power;
    };
    if (steps_taken % kCheckEvery == 0) look_at_power();
    for (int s = 0; s < count; ++s) {
      if (left == 0) {
        if (course.begin_row(u)) look_at_power();
        left = course.steps;
      }
      threads.step(y, u);
      most += given;
      if (--left == 0) course.end_row(y);
    }
    course.left = left;
    x = y;
    for (int j = 0; j < Stepper::row; ++j) applied[j] = u[j];
    balance.allow(most);
    steps_taken += count;
  }

  Instant instant() const {
    Instant instant = {x, threads.memory(), balance, {}, power, steps_taken};
    for (int j = 0; j < Stepper::row; ++j) instant.u[j] = applied[j];
    return instant;
  }

  void go_back(const Instant& to) {
    threads.end();
    threads.restore(to.past);
    x = to.x;
    balance = to.balance;
    for (int j = 0; j < Stepper::row; ++j) applied[j] = to.u[j];
    power = to.power;
    steps_taken = to.steps_taken;
  }

  // Repeat a chunk one step at a time, up to the last state within bounds.
  int creep_to_the_fault(const Course& from, int chunk) {
    Course course = from;
    for (int s = 0; s < chunk; ++s) {
      const Instant before = instant();
      threads.begin(1, x);
      run(course, 1);
      const int joint = joint_out_of_bounds(x);
      if (joint >= 0) {
        go_back(before);
        return joint;
      }
      threads.end();
    }
    __builtin_unreachable();  // the same steps as before end at the same fault
  }

  // The first joint whose state is not finite, or that turns so far in one step that the result
  // means nothing; -1 if there is none.
  int joint_out_of_bounds(const State<S>& s) const {
    int found = -1;
    numbers.for_each_drive([&](const auto& drive, int j) {
      if (found >= 0) return;
      const auto at = input_of(drive, j, s, 0.0);
      bool sound = is_finite(at.q) && is_finite(at.v);
      for (int k = 0; k < drive.states; ++k) sound = sound && is_finite(at.z[k]);
      const double turns[] = {h * at.v, h * drive.gear.Ng * drive.motor_speed(at)};
      for (const double turn : turns)
        sound = sound && turn <= kLargestTurn && turn >= -kLargestTurn;
      if (!sound) found = j;
    });
    return found;
  }

  double h;
  Numbers<S> numbers;
  Threads threads;
  State<S> x = {};
  EnergyBalance<S> balance;
  double applied[Stepper::row] = {};
  double power = 0.0;
  std::int64_t steps_taken = 0;
  int fault = -1;  // the joint that went out of bounds
  Instant checked = {};
};

}  // namespace arm
