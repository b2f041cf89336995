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
  using Vector = double[N];
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
    for (int j = 0; j < N; ++j) {
      const double Ng = S::joint[j].gear.Ng;
      x.q[j] = q[j];
      x.v[j] = v[j];
      x.i[j] = 0.0;
      x.tm[j] = q[j] / Ng;
      x.wm[j] = v[j] / Ng;
    }
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
      const State<N> before = x;
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
  const State<N>& state() const { return x; }

  // A rigid gear's motor follows its link.
  double motor_angle(int j) const {
    const Gear& gear = S::joint[j].gear;
    return gear.rigid ? x.q[j] / gear.Ng : x.tm[j];
  }
  double motor_speed(int j) const {
    const Gear& gear = S::joint[j].gear;
    return gear.rigid ? x.v[j] / gear.Ng : x.wm[j];
  }

  // Torque that each gear puts on its link [N m]; a rigid gear's is what is left for the link when
  // the motor has accelerated its rotor.
  void gear_torques(Vector& T) const {
    Vector a = {};
    if constexpr (any_rigid()) {
      typename Links<S>::Dynamics links;
      Links<S>::dynamics(x.q, x.v, links);
      for (int j = 0; j < N; ++j) {
        links.M.at[j][j] += carried_rotor(S::joint[j]);
        a[j] = drive_torque(S::joint[j], x, j) - links.nle[j] - S::joint[j].Dl * x.v[j];
      }
      Friction<S>().solve(links.M.at, x.v, a);
    }
    for (int j = 0; j < N; ++j)
      T[j] = drive_torque(S::joint[j], x, j) - carried_rotor(S::joint[j]) * a[j];
  }

  // Kinetic, potential, elastic and magnetic energy of links, gears and motors [J].
  double energy() const { return energy_of<S>(x).total(); }

 private:
  static constexpr int kCheckEvery = 16;
  static constexpr double kLargestTurn = 3.14159265358979;  // rad (or m) in one step

  // What is to be done: rows of voltages, each for some steps.
  struct Course {
    const double* voltage;  // of the next row
    double* q;              // for the positions after this row
    std::int64_t steps;     // of a row
    std::int64_t left;      // of this row
    Vector V;               // of this row, within the supply

    ARM_INLINE void begin_row() {
      for_each<N>([&](auto j) __attribute__((always_inline)) {
        V[j] = clamp(voltage[j], S::supply_voltage);
      });
      voltage += N;
    }
    ARM_INLINE void end_row(const State<N>& x) {
      for_each<N>([&](auto j) __attribute__((always_inline)) { q[j] = x.q[j]; });
      q += N;
    }
  };

  // Neither inlined nor cloned: every step, however it is asked for, runs the same instructions and
  // gives the same bits.
  __attribute__((noinline, noclone)) void run(Course& course, int count) {
    State<N> y = x;  // here, as `left`, where the compiler may keep it in registers
    std::int64_t left = course.left;
    double power = EnergyBalance<S>::largest_power(y, course.V), energy = 0.0;
    for (int s = 0; s < count; ++s) {
      if (left == 0) {
        course.begin_row();
        power = EnergyBalance<S>::largest_power(y, course.V);
        left = course.steps;
      }
      threads.step(y, course.V);
      energy += h * power;
      if (--left == 0) course.end_row(y);
    }
    course.left = left;
    x = y;
    balance.give(energy);
  }

  void go_back(const State<N>& before, const typename Threads::Memory& memory) {
    threads.end();
    threads.restore(memory);
    x = before;
  }

  // Repeat a chunk one step at a time, up to the last state within bounds.
  int creep_to_the_fault(Course course, int chunk) {
    for (int s = 0; s < chunk; ++s) {
      const State<N> before = x;
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
  int joint_out_of_bounds(const State<N>& s) const {
    for (int j = 0; j < N; ++j) {
      const double Ng = S::joint[j].gear.Ng;
      const double values[] = {s.i[j], s.tm[j], s.wm[j], s.q[j], s.v[j]};
      for (const double value : values)
        if (!is_finite(value)) return j;
      if (h * clamp(s.v[j], 1e300) > kLargestTurn || h * clamp(s.v[j], 1e300) < -kLargestTurn ||
          h * Ng * s.wm[j] > kLargestTurn || h * Ng * s.wm[j] < -kLargestTurn)
        return j;
    }
    return -1;
  }

  static constexpr bool any_rigid() {
    for (const Joint& joint : S::joint)
      if (joint.motor.present && joint.gear.rigid) return true;
    return false;
  }

  double h;
  Threads threads;
  State<N> x = {};
  EnergyBalance<S> balance;
  int fault = -1;  // the joint that went out of bounds
  std::int64_t steps_taken = 0;
};

}  // namespace arm
