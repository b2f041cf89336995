// The drives' parts of one step of a length of its own (event_location.hpp): what DriveTables
// answers, but without tables, which take longer than one step with them saves.
#pragma once

#include "schemes/drive_tables_by_mode.hpp"

namespace arm {

template <class S>
class TrialDrives : public ServedDrives<S, Real> {
 public:
  using Served = ServedDrives<S, Real>;
  using Served::K, Served::M, Served::R, Served::row;
  using typename Served::In, typename Served::Inputs, typename Served::Modes;
  using Row = arm::Row<S::N, Real>;
  static constexpr bool has_past = false;

  TrialDrives(const Numbers<S, Real>& numbers, const MakeImplicit& maker) : Served(numbers) {
    for (Group& group : of_) group.drive = Linear::none();
    fill();
    retime(maker);
  }
  // All numbers have changed. All parts are in their regular modes; `retime` is due.
  void fill() {
    this->take_linear();
    this->n_.for_each_drive([&](const auto& drive, int j) { put(drive, j, Modes{}); });
  }
  // Put joint j into these modes; `retime` is due.
  void serve(int j, const Modes& modes) {
    if (modes.active() == this->served(j).active()) return this->note(j, modes);
    this->n_.for_each_drive([&](const auto& drive, int i) {
      if (i == j) put(drive, j, modes);
    });
  }
  void retime(const MakeImplicit& maker) {
    h_ = maker.h;
    for (int g = 0; g < Row::groups; ++g) retime_group(g);
  }

  // See DriveTables. Each relies on those before it.
  template <bool = false>
  ARM_INLINE Row first(const Inputs& in) {
    return of_groups([&](Group& group, int g)
                         __attribute__((always_inline)) { return first_of(group, in, g); });
  }
  ARM_INLINE Row rates_at_rest(int k, const Inputs&) {
    return of_groups([&](Group& group, int) { return group.first.z[k]; });
  }
  template <bool = false>
  ARM_INLINE Row rates(int k, const Inputs& in) {
    return of_groups([&](Group& group, int g) { return group.rate(k, in[In::k1].at[g]); });
  }
  ARM_INLINE Row second(const Inputs& in) {
    return of_groups([&](Group& group, int g)
                         __attribute__((always_inline)) { return second_of(group, in, g); });
  }
  template <int stages, bool = false>
  ARM_INLINE void add(const Inputs& in, Row* z) {
    static_assert(stages == 2);
    for (int k = 0; k < K; ++k)
      z[k] = of_groups([&](Group& group, int g)
                           __attribute__((always_inline)) { return end_of(group, k, in, g); });
  }

  // Parts of a step of one joint, of numbers with derivatives, from the inputs in[...].at[0].
  void retime(const MakeImplicit& maker, int j)
    requires(kDifferentiates)
  {
    h_ = maker.h;
    retime_group(j);
  }
  Real first_at(int j, const auto& in) { return first_of(of_[j], in, 0); }
  Real rate_at(int k, int j, const auto& in) const { return of_[j].rate(k, in[In::k1].at[0]); }
  Real second_at(int j, const auto& in) { return second_of(of_[j], in, 0); }
  Real end_at(int k, int j, const auto& in) { return end_of(of_[j], k, in, 0); }

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

  ARM_INLINE void retime_group(int g) {
    Group& group = of_[g];
    group.eliminate.put(group.drive, gamma_of(2) * h_);
    Row::store_group(diagonal, g, group.eliminate.s * group.eliminate.b);
  }
  // For the joints side by side, from the inputs in[...].at[g].
  ARM_INLINE static Vector first_of(Group& group, const auto& in, int g) {
    Vector f[kRows] = {}, torque = {};
    for (int c = 0; c < Linear::kColumns; ++c) {
      for (int k = 0; k < K; ++k) f[k] += group.drive.F[k][c] * in[c].at[g];
      torque += group.drive.G[c] * in[c].at[g];
    }
    add_rest(in, In::rest, g, f, torque);
    group.first = group.eliminate.stage(group.drive, f, in[In::v].at[g], torque);
    return group.first.rhs;
  }
  ARM_INLINE static Vector second_of(Group& group, const auto& in, int g) {
    const Vector a = in[In::k1].at[g];
    const auto& [s, E, e, b] = group.eliminate;
    Vector r_z[kRows] = {}, r_v = kSqrt2 * (group.first.rhs - s * b * a);
    for (int k = 0; k < K; ++k) r_z[k] = kSqrt2 * group.drive.D[k] * group.rate(k, a);
    add_rest(in, In::change, g, r_z, r_v);
    const Vector r_q = kSqrt2 * (in[In::v].at[g] + s * a);
    group.second = group.eliminate.stage(group.drive, r_z, r_q, r_v);
    return group.second.rhs;
  }
  ARM_INLINE Vector end_of(Group& group, int k, const auto& in, int g) const {
    const Vector k2 = group.second.z[k] + group.eliminate.e[k] * in[In::k2].at[g];
    return in[k].at[g] + h_ * (gamma_of(2) * group.rate(k, in[In::k1].at[g]) + 0.5 * k2);
  }

  ARM_INLINE Row of_groups(auto&& number) {
    Row row;
    for (int g = 0; g < Row::groups; ++g) row.at[g] = number(of_[g], g);
    return row;
  }
  ARM_INLINE static void add_rest(const auto& in, int first, int g, Vector (&f)[kRows],
                                  Vector& torque) {
    if constexpr (R > 0) {
      for (int k = 0; k < K; ++k)
        if (Served::bends(k)) f[k] += in[first + k].at[g];
      torque += in[first + K].at[g];
    }
  }
  ARM_APART void put(const auto& drive, int j, const Modes& modes) {
    this->note(j, modes);
    of_[j / Row::group].drive.put(j % Row::group, LinearDrive<K, M>::of(drive, modes.active()));
  }

  Real h_;
  Group of_[Row::groups];
};

}  // namespace arm
