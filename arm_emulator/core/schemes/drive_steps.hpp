// The drive's part of a step of one joint, of numbers with derivatives (step_slopes.hpp): what
// LinearlyImplicit does for all joints side by side.
#pragma once

#include "mechanics/coulomb.hpp"
#include "mechanics/modes.hpp"
#include "schemes/drive_tables.hpp"
#include "schemes/trial_drives.hpp"

namespace arm {

template <class S, class Tables>
class DriveSteps {
 public:
  using In = typename Tables::In;
  static constexpr int N = S::N, K = Tables::K;
  using One = Row<1, Real>;
  using Inputs = One[In::count];

  // `tables` are in the modes of the drives.
  DriveSteps(Tables& tables, const Numbers<S>& numbers,
             const typename Coulomb<S, Real>::Modes& friction)
      : tables_(tables), n_(numbers), friction_(friction) {}

  // body(drive, its linear drive, j) of every joint.
  template <class Body>
  void for_each_joint(Body&& body) const {
    [&]<int... j>(std::integer_sequence<int, j...>) {
      (body(std::get<j>(n_.drives()), tables_.template linear_drive<j>(), j), ...);
    }(std::make_integer_sequence<int, N>{});
  }

  // The drive's part of the link's row in the first stage, from x on.
  Real compute_first_rhs(const auto& drive, const auto& linear, int j, const State<S>& x,
                         const Real& u, Inputs& in) const {
    for (int k = 0; k < K; ++k) in[k].at[0] = x.z[k][j];
    in[In::q].at[0] = x.q[j], in[In::v].at[0] = x.v[j], in[In::u].at[0] = u;
    const auto& modes = tables_.modes_of(j);
    for (int m = 0; m < Tables::M; ++m) in[In::offset + m].at[0] = modes.at[m].offset;
    if constexpr (Tables::R > 0) {
      Real nonlinear[Tables::R] = {};
      tables_.compute_nonlinear_part(drive, linear, make_input(drive, in, in), modes.active(),
                                     nonlinear);
      for (int r = 0; r < Tables::R; ++r) in[In::nonlinear + r].at[0] = nonlinear[r];
    }
    return tables_.compute_first_rhs_of(j, in) - friction_torque(drive, j, in, in);
  }
  // The drive's part in the second stage, with the link's acceleration in the first.
  Real compute_second_rhs(const auto& drive, const auto& linear, int j, double h, const Real& k1,
                          Inputs& in) const {
    in[In::k1].at[0] = k1;
    Real change = 0.0;
    if constexpr (Tables::R > 0) {
      One y[K + 2];
      for (int k = 0; k < K; ++k) y[k].at[0] = in[k].at[0] + h * tables_.compute_rate_of(k, j, in);
      const Real& v = in[In::v].at[0];
      y[In::q].at[0] = in[In::q].at[0] + h * (v + find_gamma(2) * h * k1);
      y[In::v].at[0] = v + h * k1;
      Real there[Tables::R] = {};
      tables_.compute_nonlinear_part(drive, linear, make_input(drive, y, in),
                                     tables_.modes_of(j).active(), there);
      for (int r = 0; r < Tables::R; ++r)
        in[In::change + r].at[0] = there[r] - in[In::nonlinear + r].at[0];
      if constexpr (Coulomb<S, Real>::varies)
        change = friction_torque(drive, j, in, in) - friction_torque(drive, j, y, in);
    }
    return tables_.compute_second_rhs_of(j, in) + change -
           kSqrt2 * friction_torque(drive, j, in, in);
  }
  // State k after the step, with the accelerations in both.
  Real compute_end_state(int k, int j, const Real& k2, Inputs& in) const {
    in[In::k2].at[0] = k2;
    return tables_.compute_end_state_of(k, j, in);
  }

 private:
  // The drive at z, q and v of `at`.
  template <class Drive>
  typename Drive::template Input<Real> make_input(const Drive&, const One* at,
                                                  const Inputs& in) const {
    const Real &q = at[In::q].at[0], &v = at[In::v].at[0];
    typename Drive::template Input<Real> x = {{}, q, v, in[In::u].at[0], {}};
    for (int k = 0; k < Drive::states; ++k) x.z[k] = at[k].at[0];
    for (int m = 0; m < Drive::modes; ++m) x.offset[m] = in[In::offset + m].at[0];
    return x;
  }
  // Torque of dry friction against the motion of a link that slides.
  Real friction_torque(const auto& drive, int j, const One* at, const Inputs& in) const {
    if constexpr (Coulomb<S, Real>::varies)
      return drive.sliding_torque(make_input(drive, at, in), tables_.modes_of(j).active(),
                                  friction_.direction[j]) *
             friction_.direction[j];
    else if constexpr (Coulomb<S, Real>::present)
      return n_.Dc(j) * friction_.direction[j];
    return 0.0;
  }

  Tables& tables_;
  const Numbers<S>& n_;
  const typename Coulomb<S, Real>::Modes& friction_;
};

}  // namespace arm
