// Motions with bounded speed and acceleration: to a position, and to a speed.
#pragma once

#include <cmath>

namespace fieldbus {

struct ProfileLimits {
  double speed;         // > 0
  double acceleration;  // > 0
  double deceleration;  // > 0
};

// The fastest motion to rest at a position within limits: speed up, cruise, slow down; first slow
// down if too fast, or if the way leads back. In closed form, so that end and duration are exact.
class Trapezoid {
 public:
  void plan(double position, double speed, double target, const ProfileLimits& limits) {
    count_ = 0;
    time_ = 0.0;
    target_ = target;
    double x = position, v = speed;
    const double stop = v * std::fabs(v) / (2.0 * limits.deceleration);
    if (v * (target - x - stop) < 0.0) {  // away from the target, or beyond it
      add(x, v, std::fabs(v) / limits.deceleration,
          v > 0.0 ? -limits.deceleration : limits.deceleration);
      x += stop;
      v = 0.0;
    }
    const double way = target - x;
    const double sign = way < 0.0 ? -1.0 : 1.0;
    const double distance = std::fabs(way), a = limits.acceleration, d = limits.deceleration;
    double u = std::fabs(v);  // along the way
    double left = distance;
    if (u > limits.speed) {
      add(x, v, (u - limits.speed) / d, -sign * d);
      const double covered = (u * u - limits.speed * limits.speed) / (2.0 * d);
      x += sign * covered;
      left -= covered;
      u = limits.speed;
    }
    double peak = std::sqrt((2.0 * a * d * left + d * u * u) / (a + d));
    if (peak < u) peak = u;
    if (peak > limits.speed) peak = limits.speed;
    const double up = (peak * peak - u * u) / (2.0 * a), down = peak * peak / (2.0 * d);
    add(x, sign * u, (peak - u) / a, sign * a);
    x += sign * up;
    const double even = left - up - down;
    if (even > 0.0 && peak > 0.0) {
      add(x, sign * peak, even / peak, 0.0);
      x += sign * even;
    }
    add(x, sign * peak, peak / d, -sign * d);
  }
  // Hold a position.
  void hold_standstill(double position) {
    count_ = 0;
    time_ = 0.0;
    target_ = position;
  }

  double target() const { return target_; }
  // s, from the plan on.
  double duration() const {
    double all = 0.0;
    for (int k = 0; k < count_; ++k) all += phase_[k].duration;
    return all;
  }
  bool done() const { return time_ >= duration(); }

  void advance(double dt, double& position, double& speed) {
    time_ += dt;
    double t = time_;
    for (int k = 0; k < count_; ++k) {
      const Phase& phase = phase_[k];
      if (t < phase.duration) {
        position = phase.position + (phase.speed + 0.5 * phase.acceleration * t) * t;
        speed = phase.speed + phase.acceleration * t;
        return;
      }
      t -= phase.duration;
    }
    position = target_;
    speed = 0.0;
  }

 private:
  struct Phase {
    double position, speed, duration, acceleration;
  };
  void add(double position, double speed, double duration, double acceleration) {
    if (duration > 0.0) phase_[count_++] = {position, speed, duration, acceleration};
  }

  Phase phase_[5] = {};
  int count_ = 0;
  double time_ = 0.0, target_ = 0.0;
};

// One step of a speed towards another.
inline double ramp(double speed, double target, double acceleration, double deceleration,
                   double dt) {
  double left = dt;
  if (speed * (target - speed) < 0.0) {  // it slows down, at most to 0
    const double goal = speed * target > 0.0 ? target : 0.0;
    const double time = std::fabs(speed - goal) / deceleration;
    if (time >= left) return speed + (goal > speed ? deceleration : -deceleration) * left;
    left -= time;
    speed = goal;
  }
  const double limit = acceleration * left, way = target - speed;
  return std::fabs(way) <= limit ? target : speed + (way > 0.0 ? limit : -limit);
}

}  // namespace fieldbus
