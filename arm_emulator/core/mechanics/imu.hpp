// An inertial measurement unit on a link: specific force and angular rate in a frame that is fixed
// to the link.
//
// Specific force is the acceleration of the frame's origin less that of free fall, so that a unit
// at rest measures 1 g upwards. Joint accelerations follow from the equations of motion at that
// instant, with its friction and the newest voltage.
#pragma once

#include "mechanics/links/links.hpp"
#include "parts/measuring/analog_sensor.hpp"

namespace arm {

struct ImuReading {
  double specific_force[3] = {};  // m/s2
  double angular_rate[3] = {};    // rad/s

  template <class Number>
  void for_each_number(Number&& number) {
    for (double& f : specific_force) number(f);
    for (double& w : angular_rate) number(w);
  }
};

struct Imu {
  int link = 0;
  Vec3<double> p;        // m, its origin in the link's frame (scene.hpp)
  Vec3<double> axis[3];  // its axes in that frame
  int delay = 0;         // servo periods
  AnalogSensor accelerometer[3] = {}, gyroscope[3] = {};

  // `noises(k)`: of its six channels.
  template <class Noises>
  ImuReading read(const Vec3<double>& force, const Vec3<double>& rate, Noises&& noises,
                  std::int64_t number) const {
    ImuReading reading;
    for (int k = 0; k < 3; ++k) {
      reading.specific_force[k] = accelerometer[k].read(dot(axis[k], force), noises(k), number);
      reading.angular_rate[k] = gyroscope[k].read(dot(axis[k], rate), noises(3 + k), number);
    }
    return reading;
  }
};

// Motion of a link in its own frame: angular rate, angular acceleration, and specific force at the
// frame's origin.
struct LinkMotion {
  Vec3<double> omega, alpha, force;

  Vec3<double> force_at(const Vec3<double>& p) const {
    return force + cross(alpha, p) + cross(omega, cross(omega, p));
  }
};

// The motions of all links at (q, v) with joint accelerations a; the recursion is that of
// Links::inverse_dynamics.
template <class S>
void compute_link_motions(const Numbers<S>& n, const double* q, const double* v, const double* a,
                          LinkMotion* motions) {
  using Tree = LinkTree<S>;
  typename Tree::Kinematics k;
  Links<S>::compute_kinematics(n, q, k);
  [[maybe_unused]] double of_joints[2][S::L];
  if constexpr (kCoupled<S>) {
    Links<S>::map_to_joints(v, of_joints[0]), Links<S>::map_to_joints(a, of_joints[1]);
    v = of_joints[0], a = of_joints[1];
  }
  const LinkMotion base = {{}, {}, -n.gravity()};
  for (int i = 0; i < S::L; ++i) {
    const auto& link = k.link[i];
    const int parent = kTree<S>.parent[i];
    LinkMotion m = parent < 0 ? base : motions[parent];
    const Vec3<double> at_joint = m.force_at(link.p);
    m.omega = link.to_child(m.omega);
    m.alpha = link.to_child(m.alpha);
    m.force = link.to_child(at_joint);
    if (Tree::revolute(i)) {
      m.alpha = m.alpha + Vec3<double>{m.omega.y * v[i], -m.omega.x * v[i], a[i]};
      m.omega.z += v[i];
    } else {
      m.force = m.force + Vec3<double>{2.0 * m.omega.y * v[i], -2.0 * m.omega.x * v[i], a[i]};
    }
    motions[i] = m;
  }
}

}  // namespace arm
