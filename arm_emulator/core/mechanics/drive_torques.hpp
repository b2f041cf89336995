// The torques that the rates of a drive sum up, each in the direction of its shaft.
#pragma once

#include "mechanics/drive.hpp"

namespace arm {

template <int extras>
struct DriveTorques {
  Real motor, gear_on_rotor, rotor_friction;  // on a rotor behind an elastic gear
  Real gear, viscous;                         // on the link
  Real extra[extras + 1];                     // on either, see Drive::on_the_rotor
};

template <class Drive, int n, int M>
constexpr auto torques_in(const Drive& drive, const DriveInput<n, M, Real>& x, unsigned held) {
  DriveTorques<Drive::extra_count> on = {};
  on.viscous = -drive.friction.Dv * x.v;
  Real shaft = 0.0;
  if constexpr (Drive::driven) on.motor = shaft = drive.motor.torque(x.z, drive.motor_angle(x));
  int which = 0;
  drive.for_each_extra([&]<class Extra>(const Extra& extra, auto state, auto mode) {
    on.extra[which] = drive.template torque_of<state, mode>(extra, x, held);
    if (Extra::place == Place::rotor) shaft += on.extra[which];
    ++which;
  });
  if constexpr (Drive::elastic) {
    on.gear = drive.gear_on_link(x, held);
    on.gear_on_rotor = -drive.on_rotor(x, on.gear);
    if constexpr (Drive::rotor_modes > 0)
      on.rotor_friction =
          is_held(held, Drive::of_rotor)
              ? -(shaft + on.gear_on_rotor)
              : -drive.rotor.against(x.z[Drive::wm], -on.gear_on_rotor, x.offset[Drive::of_rotor]);
  } else if constexpr (Drive::driven) {
    if constexpr (Drive::rotor_modes > 0)
      on.rotor_friction = -drive.rotor.law.Dv * drive.motor_speed(x);
    on.gear = (shaft + on.rotor_friction) / drive.gear.Ng;
  }
  return on;
}

}  // namespace arm
