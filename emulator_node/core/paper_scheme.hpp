// The paper's scheme: backward Euler for the motors, forward Euler for the links, one step for
// both.
#pragma once

#include "friction.hpp"
#include "links.hpp"
#include "motors.hpp"
#include "state.hpp"

namespace arm {

template <class S>
class PaperScheme {
 public:
  static constexpr int N = S::N;
  using Dynamics = typename Links<S>::Dynamics;

  explicit PaperScheme(double step) : h(step) {
    for (int j = 0; j < N; ++j)
      if (S::joint[j].motor.present) motor[j] = motor_step(S::joint[j].motor, S::joint[j].gear, h);
  }

  // It takes nothing from the past.
  struct Memory {};
  void reset(const State<N>&) {}
  Memory memory() const { return {}; }
  void restore(Memory) {}

  // From sample k to k + 1 with the voltages V. The links' part comes from `exchange`, which is
  // given the links as soon as they have moved on (two_threads.hpp).
  template <class Exchange>
  ARM_INLINE void step(State<N>& x, const double (&V)[N], Dynamics& links, Exchange& exchange) {
    double a[N];
    motors(x, V);
    exchange.take(links);
    accelerations(x, links, a);
    integrate(x, a);
    exchange.give(x);
  }

 private:
  // Eq. (3), the links held at sample k.
  ARM_INLINE void motors(State<N>& x, const double (&V)[N]) const {
    for_each<N>([&](auto j) __attribute__((always_inline)) {
      const Motor& m = S::joint[j].motor;
      const Gear& gear = S::joint[j].gear;
      if (!m.present) return;
      if (gear.rigid)
        x.i[j] = step_current(m, motor[j], V[j], x.i[j], x.v[j] / gear.Ng);
      else
        step_motor(m, gear, motor[j], h, V[j], x.q[j], x.v[j], x.i[j], x.tm[j], x.wm[j]);
    });
  }

  // Eq. (4) with the motors at sample k + 1.
  ARM_INLINE void accelerations(const State<N>& x, Dynamics& links, double (&a)[N]) {
    for_each<N>([&](auto j) __attribute__((always_inline)) {
      links.M.at[j][j] += carried_rotor(S::joint[j]);
      a[j] = drive_torque(S::joint[j], x, j) - links.nle[j] - S::joint[j].Dl * x.v[j];
    });
    friction.solve(links.M.at, x.v, a);
  }

  ARM_INLINE void integrate(State<N>& x, const double (&a)[N]) const {
    for_each<N>([&](auto j) __attribute__((always_inline)) {
      x.q[j] += h * x.v[j];
      x.v[j] += h * a[j];
    });
    friction.stop_at_reversal(x.v);
  }

  double h;
  MotorStep motor[N] = {};
  Friction<S> friction;
};

}  // namespace arm
