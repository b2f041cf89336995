// The drives' parts of one step of a length of its own (event_location.hpp): what DriveTables
// answers, but without tables, which take longer than one step with them saves.
#pragma once

#include "schemes/modal_drives.hpp"

namespace arm {

template <class S>
class TrialDrives : public ModalDrives<S, Real> {
 public:
  using Modal = ModalDrives<S, Real>;
  using Modal::K, Modal::M, Modal::R, Modal::row;
  using typename Modal::In, typename Modal::Inputs, typename Modal::Modes;
  using Row = arm::Row<S::N, Real>;
  static constexpr bool has_past = false;

  TrialDrives(const Numbers<S, Real>& numbers, const MakeImplicit& maker) : Modal(numbers) {
    for (Group& group : groups_) group.drive = Linear::make_resting();
    fill();
    set_step(maker);
  }
  // All numbers have changed. All parts are in their regular modes; `set_step` is due.
  void fill() {
    this->update_linear();
    this->n_.for_each_drive([&](const auto& drive, int j) { replace_drive(drive, j, Modes{}); });
  }
  // Put joint j into these modes; `set_step` is due.
  void set_modes(int j, const Modes& modes) {
    if (modes.active() == this->modes_of(j).active()) return this->record_modes(j, modes);
    this->n_.for_each_drive([&](const auto& drive, int i) {
      if (i == j) replace_drive(drive, j, modes);
    });
  }
  void set_step(const MakeImplicit& maker) {
    h_ = maker.h;
    for (int g = 0; g < Row::groups; ++g) set_group_step(g);
  }

  // See DriveTables. Each relies on those before it.
  template <bool = false>
  ARM_INLINE Row compute_first_rhs(const Inputs& in) {
    return for_groups([&](Group& group, int g) __attribute__((always_inline)) {
      return compute_group_first(group, in, g);
    });
  }
  ARM_INLINE Row compute_rates_at_rest(int k, const Inputs&) {
    return for_groups([&](Group& group, int) { return group.first.z[k]; });
  }
  template <bool = false>
  ARM_INLINE Row compute_rates(int k, const Inputs& in) {
    return for_groups([&](Group& group, int g) { return group.rate(k, in[In::k1].at[g]); });
  }
  ARM_INLINE Row compute_second_rhs(const Inputs& in) {
    return for_groups([&](Group& group, int g) __attribute__((always_inline)) {
      return compute_group_second(group, in, g);
    });
  }
  template <int stages, bool = false>
  ARM_INLINE void add_increments(const Inputs& in, Row* z) {
    static_assert(stages == 2);
    for (int k = 0; k < K; ++k)
      z[k] = for_groups([&](Group& group, int g) __attribute__((always_inline)) {
        return compute_group_end(group, k, in, g);
      });
  }

  // Parts of a step of one joint, of numbers with derivatives, from the inputs in[...].at[0].
  void set_step(const MakeImplicit& maker, int j)
    requires(kDifferentiates)
  {
    h_ = maker.h;
    set_group_step(j);
  }
  Real compute_first_rhs_of(int j, const auto& in) {
    return compute_group_first(groups_[j], in, 0);
  }
  Real compute_rate_of(int k, int j, const auto& in) const {
    return groups_[j].rate(k, in[In::k1].at[0]);
  }
  Real compute_second_rhs_of(int j, const auto& in) {
    return compute_group_second(groups_[j], in, 0);
  }
  Real compute_end_state_of(int k, int j, const auto& in) {
    return compute_group_end(groups_[j], k, in, 0);
  }

  alignas(64) Real diagonal[row] = {};

 private:
  using Vector = typename Row::Vector;
  using Linear = LinearDrive<K, M, Vector>;
  using Reduced = Elimination<K, M, Vector>;
  static constexpr int kRows = Linear::kRows;
  // Joints side by side.
  struct Group {
    Linear drive;
    Reduced eliminate;
    typename Reduced::Stage first, second;

    ARM_INLINE Vector rate(int k, const Vector& a) const { return first.z[k] + eliminate.e[k] * a; }
  };

  ARM_INLINE void set_group_step(int g) {
    Group& group = groups_[g];
    group.eliminate.prepare(group.drive, find_gamma(2) * h_);
    Row::store_group(diagonal, g, group.eliminate.s * group.eliminate.b);
  }
  // For the joints side by side, from the inputs in[...].at[g].
  ARM_INLINE static Vector compute_group_first(Group& group, const auto& in, int g) {
    Vector f[kRows] = {}, torque = {};
    for (int c = 0; c < Linear::kColumns; ++c) {
      for (int k = 0; k < K; ++k) f[k] += group.drive.F[k][c] * in[c].at[g];
      torque += group.drive.G[c] * in[c].at[g];
    }
    add_nonlinear_part(in, In::nonlinear, g, f, torque);
    group.first = group.eliminate.solve_stage(group.drive, f, in[In::v].at[g], torque);
    return group.first.rhs;
  }
  ARM_INLINE static Vector compute_group_second(Group& group, const auto& in, int g) {
    const Vector a = in[In::k1].at[g];
    const auto& [s, E, e, b] = group.eliminate;
    Vector r_z[kRows] = {}, r_v = kSqrt2 * (group.first.rhs - s * b * a);
    for (int k = 0; k < K; ++k) r_z[k] = kSqrt2 * group.drive.D[k] * group.rate(k, a);
    add_nonlinear_part(in, In::change, g, r_z, r_v);
    const Vector r_q = kSqrt2 * (in[In::v].at[g] + s * a);
    group.second = group.eliminate.solve_stage(group.drive, r_z, r_q, r_v);
    return group.second.rhs;
  }
  ARM_INLINE Vector compute_group_end(Group& group, int k, const auto& in, int g) const {
    const Vector k2 = group.second.z[k] + group.eliminate.e[k] * in[In::k2].at[g];
    return in[k].at[g] + h_ * (find_gamma(2) * group.rate(k, in[In::k1].at[g]) + 0.5 * k2);
  }

  ARM_INLINE Row for_groups(auto&& number) {
    Row row;
    for (int g = 0; g < Row::groups; ++g) row.at[g] = number(groups_[g], g);
    return row;
  }
  ARM_INLINE static void add_nonlinear_part(const auto& in, int first, int g, Vector (&f)[kRows],
                                            Vector& torque) {
    if constexpr (R > 0) {
      for (int k = 0; k < K; ++k)
        if (Modal::is_nonlinear(k)) f[k] += in[first + k].at[g];
      torque += in[first + K].at[g];
    }
  }
  ARM_APART void replace_drive(const auto& drive, int j, const Modes& modes) {
    this->record_modes(j, modes);
    groups_[j / Row::group].drive.write_lane(j % Row::group,
                                             LinearDrive<K, M>::linearise(drive, modes.active()));
  }

  Real h_;
  Group groups_[Row::groups];
};

}  // namespace arm
