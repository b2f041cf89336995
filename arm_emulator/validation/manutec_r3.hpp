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
// They are continuous there. Here they are sampled: x and C follow by the trapezoidal rule when the
// next sample is there, and the voltage of a period is that of its middle, so that what sampling
// costs is of second order in the period.
#include <cstdint>

#include "manutec_r3.h"

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

}  // namespace manutec

extern "C" __attribute__((visibility("default"))) int manutec_run(
    arm_machine* machine, const manutec_axis* axes, const manutec_path* path, double period,
    std::int64_t periods, double* out) {
  using namespace manutec;
  constexpr double kp = 5.0, ks = 0.5, Ts = 0.05;
  double x[kAxes], C[kAxes], dx[kAxes] = {}, dC[kAxes] = {};
  for (int j = 0; j < kAxes; ++j) x[j] = axes[j].x, C[j] = axes[j].C;
  arm_joint_command joints[kAxes] = {};
  for (arm_joint_command& joint : joints) joint = {ARM_VOLTAGE, 1, 0.0};
  arm_joint_measurement measured[kAxes];
  arm_command command = {};
  command.size = sizeof command, command.tick = -1, command.joint = joints;
  arm_measurement measurement = {};
  measurement.size = sizeof measurement, measurement.joint = measured;
  arm_truth truth = {};
  truth.size = sizeof truth;
  for (std::int64_t k = 0;; ++k, out += 5 * kAxes) {
    truth.current = out, truth.motor_angle = out + kAxes, truth.motor_speed = out + 2 * kAxes;
    truth.q = out + 3 * kAxes, truth.v = out + 4 * kAxes;
    if (const int result = arm_get_truth(machine, &truth)) return result;
    if (k == periods) return ARM_OK;
    double s, v;
    at(*path, static_cast<double>(k) * period, s, v);
    for (int j = 0; j < kAxes; ++j) {
      const manutec_axis& axis = axes[j];
      const double u = axis.n * axis.way * v +
                       kp * (axis.n * (axis.begin + axis.way * s) - truth.motor_angle[j]) -
                       truth.motor_speed[j];
      if (k > 0) x[j] += 0.5 * period * (dx[j] + u / Ts);
      dx[j] = u / Ts;
      const double slope = 25.0 * axis.w / axis.D * (truth.current[j] - ks * (x[j] + u));
      if (k > 0) C[j] += 0.5 * period * (dC[j] + slope);
      dC[j] = slope;
      joints[j].value = -5.0 * (C[j] + 0.5 * period * slope);
    }
    if (const int result = arm_exchange(machine, &command, &measurement)) return result;
  }
}
