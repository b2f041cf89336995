// An elastic gear with errors of its teeth: the twist has an error e that depends on the angles of
// motor and link,
//
//   w = Ng tm - q + e      e = sum a sin(k tm + phi)  +  sum b sin(k q + psi)
//   F = Kg w + Dg dw/dt
//
// Its forces follow from the twist by virtual work: F (1 - de/dq) on the link and F (Ng + de/dtm)
// against the rotor, The gear stores Kg w^2 / 2 and dissipates Dg (dw/dt)^2.
#pragma once

#include <array>

#include "numerics/harmonic.hpp"
#include "parts/gears/gear.hpp"

namespace arm {

template <int of_motor, int of_link>
struct KinematicErrorGear {
  constexpr bool operator==(const KinematicErrorGear&) const = default;

  Real Ng;                               // link turns per motor turn
  Real Kg;                               // N m/rad at the link
  Real Dg;                               // N m s/rad at the link
  std::array<Harmonic, of_motor> motor;  // rad at the link
  std::array<Harmonic, of_link> link;

  static constexpr bool rigid = false;
  static constexpr int states = ElasticGear::states;
  static constexpr int modes = 0;

  // The same gear without the error.
  constexpr ElasticGear linear() const { return {Ng, Kg, Dg}; }

  template <class X>
  ARM_INLINE constexpr X torque(X tm, X wm, X q, X v, X, bool) const {
    const Turn<X> by_motor = error(motor, tm), by_link = error(link, q);
    const X w = Ng * tm - q + by_motor.at + by_link.at;
    const X rate = (Ng + by_motor.slope) * wm - (1.0 - by_link.slope) * v;
    return (Kg * w + Dg * rate) * (1.0 - by_link.slope);
  }
  // The twist w, its rate, and the torque on the link from a torque F along it.
  template <class X>
  ARM_INLINE constexpr X twist(X tm, X q) const {
    return Ng * tm - q + error(motor, tm).at + error(link, q).at;
  }
  template <class X>
  ARM_INLINE constexpr X twist_rate(X tm, X wm, X q, X v) const {
    return (Ng + error(motor, tm).slope) * wm - (1.0 - error(link, q).slope) * v;
  }
  template <class X>
  ARM_INLINE constexpr X torque_on_link(X q, X F) const {
    return F * (1.0 - error(link, q).slope);
  }
  // Torque on the rotor from the torque T on the link.
  template <class X>
  ARM_INLINE constexpr X torque_on_rotor(X tm, X q, X T) const {
    return T * (Ng + error(motor, tm).slope) / (1.0 - error(link, q).slope);
  }
  template <class X>
  ARM_INLINE constexpr X stored_energy(X tm, X q) const {
    const X w = twist(tm, q);
    return 0.5 * Kg * w * w;
  }
  template <class X>
  ARM_INLINE constexpr X dissipated_power(X tm, X wm, X q, X v, bool) const {
    const X rate = twist_rate(tm, wm, q, v);
    return Dg * rate * rate;
  }

  // Rotor state for a link at (q, v) without wind-up.
  constexpr void set_unloaded(Real q, Real v, Real& tm, Real& wm) const {
    const Turn<Real> by_link = error(link, q);
    for (int round = 0; round < 20; ++round) {
      const Turn<Real> by_motor = error(motor, tm);
      tm -= (Ng * tm - q + by_motor.at + by_link.at) / (Ng + by_motor.slope);
    }
    wm = v * (1.0 - by_link.slope) / (Ng + error(motor, tm).slope);
  }

 private:
  template <class X>
  struct Turn {
    X at{}, slope{};
  };
  template <class X, std::size_t n>
  ARM_INLINE static constexpr Turn<X> error(const std::array<Harmonic, n>& all, X angle) {
    Turn<X> sum;
    for (const Harmonic& one : all) {
      const SinCos<X> wave = one.at(angle);
      sum.at += wave.sin;
      sum.slope += one.k * wave.cos;
    }
    return sum;
  }
};

}  // namespace arm
