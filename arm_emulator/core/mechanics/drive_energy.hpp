// Energy and power of a drive: in windings, rotor, gear and extras; what friction, windings, the
// gear's damping and extras take; what the supply gives, and what it can give at most.
#pragma once

#include <type_traits>

#include "mechanics/drive.hpp"

namespace arm {

template <class Drive, int n, int M, class X>
ARM_INLINE constexpr X compute_gear_energy(const Drive& drive, const DriveInput<n, M, X>& x) {
  if constexpr (Drive::has_gear_memory)
    return drive.gear.stored_energy(x.z[Drive::tm], x.q, x.z + Drive::wm + 1);
  else
    return drive.gear.stored_energy(x.z[Drive::tm], x.q);
}

template <class Drive, int n, int M, class X>
ARM_INLINE constexpr X compute_drive_energy(const Drive& drive, const DriveInput<n, M, X>& x) {
  X E = 0.5 * drive.carried() * x.v * x.v;
  if constexpr (Drive::driven) E += drive.motor.stored_energy(x.z);
  if constexpr (Drive::elastic)
    E += 0.5 * drive.motor.Mm * x.z[Drive::wm] * x.z[Drive::wm] + compute_gear_energy(drive, x);
  drive.for_each_extra([&](const auto& extra, auto state, auto) __attribute__((always_inline)) {
    E += extra.stored_energy(drive.angle_of(extra, x), x.z + state);
  });
  return E;
}

// Potential energy of extras, which may be negative.
template <class Drive, int n, int M>
constexpr Real compute_potential(const Drive& drive, const DriveInput<n, M, Real>& x) {
  Real U = 0.0;
  drive.for_each_extra([&](const auto& extra, auto, auto) {
    if constexpr (HasPotential<std::remove_cvref_t<decltype(extra)>>)
      U += extra.potential_energy_at(drive.angle_of(extra, x));
  });
  return U;
}

// In the given modes, which need not be those of x at the end of a part of a step.
template <class Drive, int n, int M>
constexpr Real compute_dissipation(const Drive& drive, const DriveInput<n, M, Real>& x,
                                   unsigned active) {
  constexpr int tm = Drive::tm, wm = Drive::wm;
  Real P = drive.friction_power(x, active, drive.friction_factors_at(x));
  if constexpr (Drive::driven) P += drive.motor.dissipated_power(x.z);
  const bool in_mode = Drive::gear_modes > 0 && is_active(active, Drive::of_gear);
  if constexpr (Drive::has_gear_memory)
    P += drive.gear.dissipated_power(x.z[tm], x.z[wm], x.q, x.v, in_mode, x.z + wm + 1);
  else if constexpr (Drive::elastic)
    P += drive.gear.dissipated_power(x.z[tm], x.z[wm], x.q, x.v, in_mode);
  drive.for_each_extra([&](const auto& extra, auto state, auto mode) {
    P += extra.dissipated_power(drive.angle_of(extra, x), drive.speed_of(extra, x), x.z + state,
                                extra.modes > 0 && is_active(active, mode));
  });
  return P;
}

template <class Drive, int n, int M>
constexpr Real compute_supplied_power(const Drive& drive, const DriveInput<n, M, Real>& x,
                                      unsigned active) {
  if constexpr (Drive::driven)
    return drive.motor.supplied_power(x.z, x.u, drive.motor_angle(x), drive.voltage_speed(x),
                                      Drive::is_motor_active(active));
  return 0.0;
}
template <class Drive, int n, int M, class X>
ARM_INLINE constexpr X compute_supply_limit(const Drive& drive, const DriveInput<n, M, X>& x) {
  if constexpr (Drive::driven) return drive.motor.supply_limit(x.z, x.u, drive.voltage_speed(x));
  return X{};
}

}  // namespace arm
