// The controllers of the Manutec r3 and their loop around the machine, in one unit with its library
// (arm.h): Modelica Standard Library, RobotR3.Components.AxisControlBus and ServoMotor.
//
// Per axis, with the path's angle and speed q_ref, v_ref, the gear's ratio n, motor angle and
// speed:
//
//   position and speed  u = n v_ref + kp (n q_ref - theta_m) - omega_m
//                       dx/dt = u / Ts                i_ref = ks (x + u)
//   current             dC/dt = 25 w / D (i - i_ref)  V = -5 C
//
// They are continuous there. Here they are sampled. x and C follow by the trapezoidal rule at the
// next sample, and the voltage of a period is that of its middle. The error of sampling is
// therefore of second order in the period.
#include <cstdint>

#include "manutec_r3.h"
#include "tick.c"

namespace manutec {

constexpr int kAxes = 6;

// s and ds/dt of a trapezoidal speed, at the time t.
void at(const manutec_path& path, double t, double& s, double& v) {
  const double rate = path.rate, change = path.change;
  const double ramp = rate / change, until = 1.0 / rate, end = until + ramp;
  if (t < ramp)
    s = 0.5 * change * t * t, v = change * t;
  else if (t < until)
    s = rate * (t - 0.5 * ramp), v = rate;
  else if (t < end)
    s = 1.0 - 0.5 * change * (end - t) * (end - t), v = change * (end - t);
  else
    s = 1.0, v = 0.0;
}

struct Controllers {
  // Write the present state to `out`, and return its rows.
  int look(const tick_machine& at) {
    truth.size = sizeof truth;
    truth.current = out, truth.motor_angle = out + kAxes, truth.motor_speed = out + 2 * kAxes;
    truth.q = out + 3 * kAxes, truth.v = out + 4 * kAxes;
    out += 5 * kAxes;
    return at.get_truth(at.machine, &truth);
  }

  const arm_command* answer(const tick_machine& at) {
    constexpr double kp = 5.0, ks = 0.5, Ts = 0.05;
    look(at);
    double s, v;
    manutec::at(*path, static_cast<double>(at.tick) * period, s, v);
    for (int j = 0; j < kAxes; ++j) {
      const manutec_axis& axis = axes[j];
      const double u = axis.n * axis.way * v +
                       kp * (axis.n * (axis.begin + axis.way * s) - truth.motor_angle[j]) -
                       truth.motor_speed[j];
      if (at.tick > 0) x[j] += 0.5 * period * (dx[j] + u / Ts);
      dx[j] = u / Ts;
      const double slope = 25.0 * axis.w / axis.D * (truth.current[j] - ks * (x[j] + u));
      if (at.tick > 0) C[j] += 0.5 * period * (dC[j] + slope);
      dC[j] = slope;
      joints[j].value = -5.0 * (C[j] + 0.5 * period * slope);
    }
    return &command;
  }

  const manutec_axis* axes;
  const manutec_path* path;
  double period, *out;
  double x[kAxes] = {}, C[kAxes] = {}, dx[kAxes] = {}, dC[kAxes] = {};
  arm_joint_command joints[kAxes] = {};
  arm_command command = {sizeof command, 0, -1, joints, nullptr};
  arm_truth truth = {};
};

}  // namespace manutec

extern "C" __attribute__((visibility("default"))) int manutec_run(
    tick_machine* at, const manutec_axis* axes, const manutec_path* path, double period,
    std::int64_t periods, double* out) {
  manutec::Controllers all = {.axes = axes, .path = path, .period = period, .out = out};
  for (int j = 0; j < manutec::kAxes; ++j) {
    all.x[j] = axes[j].x, all.C[j] = axes[j].C;
    all.joints[j] = {ARM_VOLTAGE, 1, 0.0};
  }
  const auto answer = [](void* with, const tick_machine* now) {
    return static_cast<manutec::Controllers*>(with)->answer(*now);
  };
  const tick_controller controller = {&all, answer, nullptr};
  const int result = tick_run(at, &controller, periods);
  return result == ARM_OK ? all.look(*at) : result;
}
