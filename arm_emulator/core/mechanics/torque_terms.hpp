// The torques on each link and each rotor at an instant, term by term. They sum up to 0, inertia
// included, up to rounding: the equations of motion as they are solved.
#pragma once

#include "mechanics/drive.hpp"
#include "mechanics/modes.hpp"

namespace arm {

// The torques that the rates of a drive sum up, each in the direction of its shaft.
template <int extras>
struct DriveTorques {
  Real motor, gear_on_rotor, rotor_friction;  // on a rotor behind an elastic gear
  Real gear, viscous;                         // on the link
  Real extra[extras + 1];                     // on either
  bool on_the_rotor[extras + 1];              // whether each of these is
};

template <class Drive, int n, int M>
constexpr auto compute_drive_torques(const Drive& drive, const DriveInput<n, M, Real>& x,
                                     unsigned active) {
  DriveTorques<Drive::extra_count> on = {};
  const auto factors = drive.friction_factors_at(x);
  on.viscous = -viscous_torque(drive.friction, x.v, factors);
  Real shaft = 0.0;
  if constexpr (Drive::driven) on.motor = shaft = drive.motor.torque(x.z, drive.motor_angle(x));
  int which = 0;
  drive.for_each_extra([&]<class Extra>(const Extra& extra, auto state, auto mode) {
    on.extra[which] = drive.template torque_of<state, mode>(extra, x, active);
    on.on_the_rotor[which] = Extra::place == Place::rotor;
    if (on.on_the_rotor[which]) shaft += on.extra[which];
    ++which;
  });
  if constexpr (Drive::elastic) {
    on.gear = drive.gear_torque_on_link(x, active);
    on.gear_on_rotor = -drive.torque_on_rotor(x, on.gear);
    if constexpr (Drive::rotor_modes > 0)
      on.rotor_friction =
          is_active(active, Drive::of_rotor)
              ? -(shaft + on.gear_on_rotor)
              : -drive.rotor.resisting_torque(x.z[Drive::wm], -on.gear_on_rotor, shaft,
                                              x.offset[Drive::of_rotor], factors);
  } else if constexpr (Drive::driven) {
    if constexpr (Drive::rotor_modes > 0)
      on.rotor_friction = -viscous_torque(drive.rotor.law, drive.motor_speed(x), factors);
    on.gear = (shaft + on.rotor_friction) / drive.gear.Ng;
  }
  return on;
}

template <class S>
class TorqueTerms {
 public:
  static constexpr int N = S::N;
  static constexpr int extras = [] {
    int maximum = 0;
    any_drive<S>([&](const auto& drive) {
      if (drive.extra_count > maximum) maximum = drive.extra_count;
      return false;
    });
    return maximum;
  }();
  // On the link: inertia, Coriolis and centrifugal, gravity, external wrench, gear, viscous
  // friction, dry friction, inertia of a rotor behind a rigid gear. On the rotor: inertia, motor,
  // gear, friction. Then the extras, and whether each of them acts on the rotor.
  static constexpr int fixed = 12, rows = fixed + 2 * extras;

  // Write rows of N torques [N m, N at the link of a prismatic joint]; NaN: no such part.
  static void write(const Numbers<S>& n, State<S> x, const Real* u, Real* out) {
    typename Links<S>::Dynamics links, still;
    const Real rest[N] = {};
    set_algebraic_states(n, x, u);
    Links<S>::compute_dynamics_apart(n, x.q, x.v, links);
    Links<S>::compute_dynamics_apart(n, x.q, rest, still);
    Real a[N], external[N] = {};
    const Modes<S> modes(n, x, u, links);
    typename Modes<S>::Friction coulomb(n);
    modes.compute_accelerations(x, u, links, a, coulomb);
    if constexpr (S::external_wrench) {
      typename Links<S>::Kinematics kinematics;
      Links<S>::compute_kinematics(n, x.q, kinematics);
      Links<S>::compute_external_torques(n, kinematics, external);
    }
    n.for_each_drive([&]<class Drive>(const Drive& drive, int j) {
      const auto now = modes.drive_modes(drive, j);
      const auto at = drive.apply_modes(input_of(drive, j, x, u[j]), now);
      const auto on = compute_drive_torques(drive, at, now.active());
      Real inertia = 0.0;
      for (int k = 0; k < N; ++k) inertia -= links.M.entry(j, k) * a[k];
      const Real no = no_number();
      Real row[rows] = {inertia,
                        still.nle[j] - links.nle[j],
                        -(still.nle[j] + external[j]),
                        S::external_wrench ? external[j] : no,
                        Drive::driven ? on.gear : no,
                        on.viscous,
                        -coulomb.force(j),
                        Drive::carries_rotor ? -drive.carried() * a[j] : no,
                        no,
                        Drive::driven ? on.motor : no,
                        no,
                        Drive::driven ? on.rotor_friction : no};
      if constexpr (Drive::elastic) {
        row[8] = -drive.motor.Mm * compute_rotor_acceleration(drive, at, now.active());
        row[10] = on.gear_on_rotor;
      }
      for (int e = 0; e < extras; ++e) {
        const bool there = e < Drive::extra_count;
        row[fixed + e] = there ? on.extra[e] : no;
        row[fixed + extras + e] = there && on.on_the_rotor[e] ? 1.0 : 0.0;
      }
      for (int k = 0; k < rows; ++k) out[k * N + j] = row[k];
    });
  }

 private:
  template <class Drive>
  static Real compute_rotor_acceleration(const Drive& drive,
                                         const typename Drive::template Input<Real>& x,
                                         unsigned active) {
    const Real D = drive.D(active).f[Drive::wm];
    return D > 0.0 ? drive.rates(x, active).f[Drive::wm] / D : 0.0;
  }
};

}  // namespace arm
