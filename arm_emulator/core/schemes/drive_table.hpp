// A drive's part of a step as a table of numbers, computed from its f and g.
//
// f = F (z, q, v, u, offset) + n and g = G (z, q, v) + n_g: f and g of the linear parts at a unit
// of each input are the columns of F and G. The sum n of the nonlinear parts is an input of its
// own. With s = gamma h, a stage (I - s A) k = r of a linearly implicit scheme reads, for one
// joint,
//
//   D k_z - s (F_z k_z + F_q k_q + F_v k_v) = r_z
//                                       k_q = r_q + s k_v
//   M k_v - s (G_z k_z + G_q k_q + G_v k_v) = r_v
//
// The first row gives k_z with a small matrix per joint, E = (D - s F_z)^-1:
//
//   k_z = E (r_z + s F_q r_q) + e k_v,                   e = s E (F_v + s F_q)
//   (M + s b) k_v = r_v + s (G_z E (r_z + s F_q r_q) + G_q r_q),  b = -(G_z e + s G_q + G_v)
//
// There is no division by an inductance or a stiffness, so D may have zeros and a gear may be
// arbitrarily stiff.
#pragma once

#include "schemes/linear_drive.hpp"

namespace arm {

// Inputs in which a joint's part of a step is linear. They are z, q, v, u and the numbers of its M
// modes (mode.hpp). The nonlinear parts at the step's start in the rows of f and in g follow. The
// last are the acceleration of the link in the first stage, the change of the nonlinear parts in
// it, and the acceleration in the second stage. R is K + 1, or 0 if all drives are linear.
template <int K, int M, int R>
struct StepInput {
  static constexpr int q = K, v = K + 1, u = K + 2, offset = K + 3, nonlinear = offset + M;
  static constexpr int k1 = nonlinear + R, change = k1 + 1, k2 = change + R, count = k2 + 1;
};

// One joint's part of a step of size h: each row per unit of each input.
template <int K, int M, int R>
struct DriveTable {
  using In = StepInput<K, M, R>;
  static constexpr int kRows = K > 0 ? K : 1;
  Real rhs_1[In::count];                   // of the link's row: (M + diagonal) k1 = rhs_1 - nle
  Real rhs_2[In::count];                   // (M + diagonal) k2 = rhs_2 - sqrt(2) nle
  Real dz[kRows][In::count];               // what the step adds to z
  Real diagonal;                           // s b
  Real k_z[R > 0 ? kRows : 1][In::count];  // the rates of z in the first stage
};

inline constexpr double kSqrt2 = 1.4142135623730951;

// gamma of the scheme with so many stages: implicit Euler's, and ROS2's.
constexpr double find_gamma(int stages) { return stages == 2 ? 1.0 - 0.5 * kSqrt2 : 1.0; }

// A stage of a linearly implicit scheme for one joint, or several side by side: the rates of z go
// into the link's row.
template <int K, int M, class X = Real>
struct Elimination {
  using Drive = LinearDrive<K, M, X>;
  static constexpr int n = Drive::kRows;
  Real s;
  X E[n][n], e[n], b;

  // Set up for this drive with this s.
  ARM_INLINE void prepare(const Drive& drive, Real with) {
    s = with;
    drive.invert(s, E);
    for (int r = 0; r < K; ++r) {
      e[r] = X{};
      for (int c = 0; c < K; ++c) e[r] += s * E[r][c] * (drive.F[c][K + 1] + s * drive.F[c][K]);
    }
    b = -(s * drive.G[K] + drive.G[K + 1]);
    for (int k = 0; k < K; ++k) b -= drive.G[k] * e[k];
  }
  // The rates of z without that of v, and the link's row.
  struct Stage {
    X z[n], rhs;
  };
  ARM_INLINE Stage solve_stage(const Drive& drive, const X (&r_z)[n], const auto& r_q,
                               const X& r_v) const {
    Stage stage = {{}, r_v + s * drive.G[K] * r_q};
    for (int r = 0; r < K; ++r) {
      for (int c = 0; c < K; ++c) stage.z[r] += E[r][c] * (r_z[c] + s * drive.F[c][K] * r_q);
      stage.rhs += s * drive.G[r] * stage.z[r];
    }
    return stage;
  }
};

// The table of a linearly implicit scheme with 1 or 2 stages (linearly_implicit.hpp).
template <int R, int K, int M>
ARM_APART DriveTable<K, M, R> make_implicit_table(const LinearDrive<K, M>& drive, Real h,
                                                  int stages) {
  using In = StepInput<K, M, R>;
  using X = Real;
  constexpr int n = LinearDrive<K, M>::kRows;
  Elimination<K, M> elimination = {};
  elimination.prepare(drive, find_gamma(stages) * h);
  const auto& [s, E, e, b] = elimination;
  DriveTable<K, M, R> table = {};
  table.diagonal = s * b;
  for (int input = 0; input < In::count; ++input) {
    Real x[In::count] = {};
    x[input] = 1.0;
    X f[n] = {}, g = {};
    if (input < drive.kColumns) {
      for (int k = 0; k < K; ++k) f[k] = drive.F[k][input];
      g = drive.G[input];
    }
    if constexpr (R > 0) {
      for (int k = 0; k < K; ++k) f[k] += x[In::nonlinear + k];
      g += x[In::nonlinear + K];
    }
    const auto first = elimination.solve_stage(drive, f, x[In::v], g);
    X k_z[n] = {};
    for (int k = 0; k < K; ++k) k_z[k] = first.z[k] + e[k] * x[In::k1];
    table.rhs_1[input] = first.rhs;
    if constexpr (R > 0)
      for (int k = 0; k < K; ++k) table.k_z[k][input] = k_z[k];
    if (stages == 1) {
      for (int k = 0; k < K; ++k) table.dz[k][input] = h * k_z[k];
      continue;
    }
    X r_z[n] = {};
    for (int k = 0; k < K; ++k) r_z[k] = kSqrt2 * drive.D[k] * k_z[k];
    X r_v = kSqrt2 * (first.rhs - s * b * x[In::k1]);
    if constexpr (R > 0) {
      for (int k = 0; k < K; ++k) r_z[k] += x[In::change + k];
      r_v += x[In::change + K];
    }
    const auto second =
        elimination.solve_stage(drive, r_z, kSqrt2 * (x[In::v] + s * x[In::k1]), r_v);
    table.rhs_2[input] = second.rhs;
    for (int k = 0; k < K; ++k)
      table.dz[k][input] = h * (find_gamma(2) * k_z[k] + 0.5 * (second.z[k] + e[k] * x[In::k2]));
  }
  return table;
}

struct MakeImplicit {
  Real h;
  int stages;
  template <int R, int K, int M>
  auto operator()(const LinearDrive<K, M>& drive) const {
    return make_implicit_table<R>(drive, h, stages);
  }
};

// The table of the paper's scheme: backward Euler of the drive with the link held; `rhs_1` is the
// torque on the link at the states after it. The drive's nonlinear part is that at the step's
// start.
template <int R, int K, int M>
ARM_ONCE DriveTable<K, M, R> make_paper_table(const LinearDrive<K, M>& drive, Real h) {
  using In = StepInput<K, M, R>;
  constexpr int n = LinearDrive<K, M>::kRows;
  Real E[n][n] = {};
  drive.invert(h, E);
  DriveTable<K, M, R> table = {};
  for (int input = 0; input < drive.kColumns; ++input) {
    table.rhs_1[input] = drive.G[input];
    for (int r = 0; r < K; ++r) {
      for (int c = 0; c < K; ++c) table.dz[r][input] += h * E[r][c] * drive.F[c][input];
      table.rhs_1[input] += drive.G[r] * table.dz[r][input];
    }
  }
  if constexpr (R > 0) {
    for (int c = 0; c < K; ++c)
      for (int r = 0; r < K; ++r) {
        table.dz[r][In::nonlinear + c] = h * E[r][c];
        table.rhs_1[In::nonlinear + c] += drive.G[r] * h * E[r][c];
      }
    table.rhs_1[In::nonlinear + K] = 1.0;
  }
  return table;
}

struct MakePaper {
  Real h;
  template <int R, int K, int M>
  auto operator()(const LinearDrive<K, M>& drive) const {
    return make_paper_table<R>(drive, h);
  }
};

}  // namespace arm
