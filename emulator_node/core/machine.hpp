// The machine: motors, gears and links of one scene, and their way through time.
#pragma once

#include <cstdint>
#include <type_traits>

#include "energy.hpp"
#include "finite.hpp"
#include "linearly_implicit.hpp"
#include "paper_scheme.hpp"
#include "two_threads.hpp"

namespace arm {

template <class S>
class Machine {
 public:
  static constexpr int N = S::N;

  using Stepper =
      std::conditional_t<S::scheme == Scheme::paper, PaperScheme<S>, LinearlyImplicit<S>>;

  using Threads =
      std::conditional_t<S::threads == 2, TwoThreads<S, Stepper>, OneThread<S, Stepper>>;

  // `core`: of the second thread, if there is one; -1: any.
  Machine(double dt, int core) : h(dt), threads(dt, core) {}

  // Schedule all threads as the calling one; false if the system does not permit it.
  bool join_schedule() { return threads.join_schedule(); }

  // Put the links at (q, v), the motors along with them: no current, gears unloaded.
  void reset(const double* q, const double* v) {
    x = {};
    for_each_drive<S>([&](const auto& drive, int j) {
      const auto behind = drive.at_rest_behind(q[j], v[j]);
      for (int k = 0; k < drive.states; ++k) x.z[k][j] = behind.z[k];
      x.q[j] = q[j];
      x.v[j] = v[j];
    });
    threads.reset(x);
    balance.reset(x);
    fault = -1;
    steps_taken = 0;
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
    Course course = {voltage, q, steps, 0, {}};
    std::int64_t count = rows * steps;
    if (steps == 0)
      for (std::int64_t row = 0; row < rows; ++row) course.end_row(x);
    threads.begin(count, x);
    while (count > 0) {
      const int chunk = count < kCheckEvery ? static_cast<int>(count) : kCheckEvery;
      const State<S> before = x;
      const Course course_before = course;
      const auto memory = threads.memory();
      run(course, chunk);
      if (joint_out_of_bounds(x) >= 0) {
        go_back(before, memory);
        return fault = creep_to_the_fault(course_before, chunk);
      }
      fault = balance.broken_by(x, chunk);
      if (fault >= 0) {
        go_back(before, memory);
        return fault;
      }
      steps_taken += chunk;
      count -= chunk;
    }
    threads.end();
    return -1;
  }

  double time() const { return static_cast<double>(steps_taken) * h; }
  const State<S>& state() const { return x; }

  // Current [A], angle [rad] and speed [rad/s] of each motor.
  void report(double* current, double* angle, double* speed) const {
    for_each_drive<S>([&](const auto& drive, int j) {
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
      Links<S>::dynamics(x.q, x.v, links);
      for_each_drive<S>([&](const auto& drive, int j) {
        links.M.at[j][j] += drive.carried();
        a[j] = drive.rates(input_of(drive, j, x, 0.0), false).g - links.nle[j];
      });
      Coulomb<S, double>().solve(links.M.at, x.v, a);
    }
    for_each_drive<S>([&](const auto& drive, int j) {
      T[j] = drive.gear_torque(input_of(drive, j, x, 0.0), a[j]);
    });
  }

  // Kinetic, potential, elastic and magnetic energy of links, gears and motors [J].
  double energy() const { return energy_of<S>(x).total(); }

 private:
  static constexpr int kCheckEvery = 16;
  static constexpr double kLargestTurn = 3.14159265358979;  // rad (or m) in one step

  // What is to be done: rows of voltages, each for some steps.
  struct Course {
    const double* command;               // of the next row
    double* q;                           // for the positions after this row
    std::int64_t steps;                  // of a row
    std::int64_t left;                   // of this row
    alignas(64) double u[Stepper::row];  // of this row, within the supply

    ARM_INLINE void begin_row() {
      for_each<N>([&](auto j) __attribute__((always_inline)) {
        u[j] = clamp(command[j], S::supply_voltage);
      });
      command += N;
    }
    ARM_INLINE void end_row(const State<S>& x) {
      for_each<N>([&](auto j) __attribute__((always_inline)) { q[j] = x.q[j]; });
      q += N;
    }
  };

  // Neither inlined nor cloned: every step, however it is asked for, runs the same instructions and
  // gives the same bits.
  __attribute__((noinline, noclone)) void run(Course& course, int count) {
    State<S> y = x;  // here, as `left`, where the compiler may keep it in registers
    std::int64_t left = course.left;
    double power = EnergyBalance<S>::largest_power(y, course.u), energy = 0.0;
    for (int s = 0; s < count; ++s) {
      if (left == 0) {
        course.begin_row();
        power = EnergyBalance<S>::largest_power(y, course.u);
        left = course.steps;
      }
      threads.step(y, course.u);
      energy += h * power;
      if (--left == 0) course.end_row(y);
    }
    course.left = left;
    x = y;
    balance.give(energy);
  }

  void go_back(const State<S>& before, const typename Threads::Memory& memory) {
    threads.end();
    threads.restore(memory);
    x = before;
  }

  // Repeat a chunk one step at a time, up to the last state within bounds.
  int creep_to_the_fault(const Course& from, int chunk) {
    Course course = from;
    for (int s = 0; s < chunk; ++s) {
      const State<S> before = x;
      const auto memory = threads.memory();
      threads.begin(1, x);
      run(course, 1);
      const int joint = joint_out_of_bounds(x);
      if (joint >= 0) {
        go_back(before, memory);
        return joint;
      }
      threads.end();
      ++steps_taken;
    }
    __builtin_unreachable();  // the same steps as before end at the same fault
  }

  // The first joint whose state is not finite, or that turns so far in one step that the result
  // means nothing; -1 if there is none.
  int joint_out_of_bounds(const State<S>& s) const {
    int found = -1;
    for_each_drive<S>([&](const auto& drive, int j) {
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
  Threads threads;
  State<S> x = {};
  EnergyBalance<S> balance;
  int fault = -1;  // the joint that went out of bounds
  std::int64_t steps_taken = 0;
};

}  // namespace arm
