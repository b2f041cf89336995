// A drive's part of a step as a table of numbers, computed from its f and g.
//
// f = F (z, q, v, u, offset) + n and g = G (z, q, v) + n_g: f and g of the linear parts at a unit
// of each input are the columns of F and G. The rest n of nonlinear parts is an input of its own.
// With s = gamma h, a stage (I - s A) k = r of a linearly implicit scheme reads, for one joint,
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

#include "mechanics/numbers.hpp"
#include "mechanics/state.hpp"

namespace arm {

// Loops over states and inputs of a drive are unrolled up to these.
inline constexpr int kMostStates = 16, kMostInputs = 64;

// Inputs in which a joint's part of a step is linear: z, q, v, u, the numbers of its M modes
// (mode.hpp), the nonlinear rest at the step's start in the rows of f and in g, the acceleration
// of the link in the first stage, the change of the rest in it, and the acceleration in the
// second. R is K + 1, or 0 if all drives are linear.
template <int K, int M, int R>
struct StepInput {
  static constexpr int q = K, v = K + 1, u = K + 2, offset = K + 3, rest = offset + M;
  static constexpr int k1 = rest + R, change = k1 + 1, k2 = change + R, count = k2 + 1;
};

// F and G of one drive, its states in rows of K; a missing state is constant. Of numbers X that are
// several joints side by side, those of several drives.
template <int K, int M, class X = double>
struct LinearDrive {
  static constexpr int kRows = K > 0 ? K : 1, kColumns = K + 3 + M;
  X D[kRows], F[kRows][kColumns], G[kColumns];

  // Drives at rest.
  static constexpr LinearDrive none() {
    LinearDrive rests = {};
    for (X& d : rests.D) d = X{} + 1.0;
    return rests;
  }
  // Take over the numbers of one drive.
  void put(int lane, const LinearDrive<K, M>& one) {
    for (int k = 0; k < K; ++k) {
      set_lane(D[k], lane, one.D[k]);
      for (int c = 0; c < kColumns; ++c) set_lane(F[k][c], lane, one.F[k][c]);
    }
    for (int c = 0; c < kColumns; ++c) set_lane(G[c], lane, one.G[c]);
  }

  template <class TheDrive>
  ARM_APART static constexpr LinearDrive of(const TheDrive& whole, unsigned held) {
    LinearDrive linear = {};
    const auto drive = whole.linear();
    const auto D = drive.D(held);
    for (int k = 0; k < K; ++k) linear.D[k] = k < TheDrive::states ? D.f[k] : 1.0;
    for (int column = 0; column < kColumns; ++column) {
      typename TheDrive::template Input<double> one = {};
      if (!set<TheDrive>(one, column, 1.0)) continue;
      const auto rates = drive.rates(one, held);
      for (int k = 0; k < TheDrive::states; ++k) linear.F[k][column] = rates.f[k];
      linear.G[column] = rates.g;
    }
    return linear;
  }

  // Check that a drive's linear parts are linear, with all modes held and with none: f and g of a
  // sum of inputs are the sums of theirs.
  template <class TheDrive>
  static constexpr bool is_sound(const TheDrive& whole) {
    for (unsigned held = 0; held < 1u << TheDrive::modes; ++held)
      if (!is_sound(whole, held)) return false;
    return true;
  }

  // E = (D - s F_z)^-1, by Gauss and Jordan with pivots.
  ARM_INLINE constexpr void inverse(double s, X (&E)[kRows][kRows]) const {
    X W[kRows][kRows] = {};
    for (int r = 0; r < K; ++r)
      for (int c = 0; c < K; ++c) {
        W[r][c] = (r == c ? D[r] : X{}) - s * F[r][c];
        E[r][c] = X{} + (r == c ? 1.0 : 0.0);
      }
    for (int c = 0; c < K; ++c) {
      for (int r = c + 1; r < K; ++r) {
        const auto larger = magnitude(W[r][c]) > magnitude(W[c][c]);
        if (!any(larger)) continue;
        for (int m = 0; m < K; ++m) {
          swap_where(larger, W[c][m], W[r][m]);
          swap_where(larger, E[c][m], E[r][m]);
        }
      }
      const X scale = 1.0 / W[c][c];
      for (int m = 0; m < K; ++m) W[c][m] *= scale, E[c][m] *= scale;
      for (int r = 0; r < K; ++r) {
        if (r == c) continue;
        const X factor = W[r][c];
        for (int m = 0; m < K; ++m) W[r][m] -= factor * W[c][m], E[r][m] -= factor * E[c][m];
      }
    }
  }

  // Set the input of a column; false if this drive does not have it.
  template <class TheDrive>
  ARM_APART static constexpr bool set(typename TheDrive::template Input<double>& x, int column,
                                      double value) {
    if (column < K ? column >= TheDrive::states : column >= K + 3 + TheDrive::modes) return false;
    double* const others[] = {&x.q, &x.v, &x.u};
    if (column < K)
      x.z[column] = value;
    else if (column < K + 3)
      *others[column - K] = value;
    else
      x.offset[column - K - 3] = value;
    return true;
  }

 private:
  ARM_INLINE static constexpr void swap_where(const Mask<X>& mask, X& a, X& b) {
    const X before = a;
    a = select(mask, b, a);
    b = select(mask, before, b);
  }

  template <class TheDrive>
  static constexpr bool is_sound(const TheDrive& whole, unsigned held) {
    const LinearDrive linear = of(whole, held);
    typename TheDrive::template Input<double> x = {};
    double input[kColumns] = {};
    for (int column = 0; column < kColumns; ++column)
      if (set<TheDrive>(x, column, 1.0 + 0.37 * column)) input[column] = 1.0 + 0.37 * column;
    const auto rates = whole.linear().rates(x, held);
    const auto agrees = [&](double answer, const double (&row)[kColumns]) {
      double sum = 0.0, size = 0.0;
      for (int column = 0; column < kColumns; ++column) {
        sum += row[column] * input[column];
        size += magnitude(row[column] * input[column]);
      }
      return magnitude(answer - sum) <= 1e-9 * size;
    };
    bool all = agrees(rates.g, linear.G);
    for (int k = 0; k < TheDrive::states; ++k) all = all && agrees(rates.f[k], linear.F[k]);
    return all;
  }
};

// One joint's part of a step of size h: each row per unit of each input.
template <int K, int M, int R, class X = double>
struct DriveTable {
  using In = StepInput<K, M, R>;
  static constexpr int kRows = K > 0 ? K : 1;
  X rhs_1[In::count];                   // of the link's row: (M + diagonal) k1 = rhs_1 - nle
  X rhs_2[In::count];                   // (M + diagonal) k2 = rhs_2 - sqrt(2) nle
  X dz[kRows][In::count];               // what the step adds to z
  X diagonal;                           // s b
  X k_z[R > 0 ? kRows : 1][In::count];  // the rates of z in the first stage
};

inline constexpr double kSqrt2 = 1.4142135623730951;

// gamma of the scheme with so many stages: implicit Euler's, and ROS2's.
constexpr double gamma_of(int stages) { return stages == 2 ? 1.0 - 0.5 * kSqrt2 : 1.0; }

// The table of a linearly implicit scheme with 1 or 2 stages (linearly_implicit.hpp). It is
// recomputed for each trial of an event's time (located.hpp), so it is not compiled for size.
template <int R, int K, int M, class X>
ARM_APART DriveTable<K, M, R, X> implicit_table(const LinearDrive<K, M, X>& drive, double h,
                                                int stages) {
  using In = StepInput<K, M, R>;
  constexpr int n = LinearDrive<K, M, X>::kRows;
  const double s = gamma_of(stages) * h;
  X E[n][n] = {}, e[n] = {};
  drive.inverse(s, E);
  for (int r = 0; r < K; ++r)
    for (int c = 0; c < K; ++c) e[r] += s * E[r][c] * (drive.F[c][In::v] + s * drive.F[c][In::q]);
  X b = -(s * drive.G[In::q] + drive.G[In::v]);
  for (int k = 0; k < K; ++k) b -= drive.G[k] * e[k];

  DriveTable<K, M, R, X> table = {};
  table.diagonal = s * b;
  // A stage after elimination of z: rhs of the link's row, then k_z from k_v.
  struct Stage {
    X z[n], rhs;
  };
  const auto eliminate = [&](const X(&r_z)[n], double r_q, const X& r_v) {
    Stage stage = {{}, r_v + s * drive.G[In::q] * r_q};
    for (int r = 0; r < K; ++r) {
      for (int c = 0; c < K; ++c) stage.z[r] += E[r][c] * (r_z[c] + s * drive.F[c][In::q] * r_q);
      stage.rhs += s * drive.G[r] * stage.z[r];
    }
    return stage;
  };
  for (int input = 0; input < In::count; ++input) {
    double x[In::count] = {};
    x[input] = 1.0;
    X f[n] = {}, g = {};
    if (input < drive.kColumns) {
      for (int k = 0; k < K; ++k) f[k] = drive.F[k][input];
      g = drive.G[input];
    }
    if constexpr (R > 0) {
      for (int k = 0; k < K; ++k) f[k] += x[In::rest + k];
      g += x[In::rest + K];
    }
    const Stage one = eliminate(f, x[In::v], g);
    X k_z[n] = {};
    for (int k = 0; k < K; ++k) k_z[k] = one.z[k] + e[k] * x[In::k1];
    table.rhs_1[input] = one.rhs;
    if constexpr (R > 0)
      for (int k = 0; k < K; ++k) table.k_z[k][input] = k_z[k];
    if (stages == 1) {
      for (int k = 0; k < K; ++k) table.dz[k][input] = h * k_z[k];
      continue;
    }
    X r_z[n] = {};
    for (int k = 0; k < K; ++k) r_z[k] = kSqrt2 * drive.D[k] * k_z[k];
    X r_v = kSqrt2 * (one.rhs - s * b * x[In::k1]);
    if constexpr (R > 0) {
      for (int k = 0; k < K; ++k) r_z[k] += x[In::change + k];
      r_v += x[In::change + K];
    }
    const Stage two = eliminate(r_z, kSqrt2 * (x[In::v] + s * x[In::k1]), r_v);
    table.rhs_2[input] = two.rhs;
    for (int k = 0; k < K; ++k)
      table.dz[k][input] = h * (gamma_of(2) * k_z[k] + 0.5 * (two.z[k] + e[k] * x[In::k2]));
  }
  return table;
}

struct MakeImplicit {
  double h;
  int stages;
  template <int R, int K, int M, class X>
  auto operator()(const LinearDrive<K, M, X>& drive) const {
    return implicit_table<R>(drive, h, stages);
  }
};

// The table of the paper's scheme: backward Euler of the drive with the link held; `rhs_1` is the
// torque on the link at the states after it. The drive's rest is that at the step's start.
template <int R, int K, int M>
ARM_ONCE DriveTable<K, M, R> paper_table(const LinearDrive<K, M>& drive, double h) {
  using In = StepInput<K, M, R>;
  constexpr int n = LinearDrive<K, M>::kRows;
  double E[n][n] = {};
  drive.inverse(h, E);
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
        table.dz[r][In::rest + c] = h * E[r][c];
        table.rhs_1[In::rest + c] += drive.G[r] * h * E[r][c];
      }
    table.rhs_1[In::rest + K] = 1.0;
  }
  return table;
}

struct MakePaper {
  double h;
  template <int R, int K, int M>
  auto operator()(const LinearDrive<K, M>& drive) const {
    return paper_table<R>(drive, h);
  }
};

// The tables of all joints, side by side in vectors. `Make` makes a joint's table of its linear
// drive.
template <class S, class X, class Make>
class DriveTables {
 public:
  static constexpr int N = S::N, K = most_states<S>(), row = kRow<N, X>;
  static constexpr int width = kWidth<X>;
  // Lanes have the usual modes only (smooth_together.hpp).
  static constexpr int M = width == 1 ? most_modes<S>() : 0;
  static constexpr bool linear = !any_drive<S>([](const auto& d) { return !d.is_linear; });
  static constexpr int R = linear ? 0 : K + 1;
  using In = StepInput<K, M, R>;
  static constexpr bool modal = M > 0;
  // Lanes may have drives of their own.
  static constexpr bool own = arm::Numbers<S, X>::varied && width > 1;
  using Number = std::conditional_t<own, X, double>;
  using Modes = DriveModes<M>;

  // For each input a row of numbers.
  using Numbers = Number[In::count][row];
  using Inputs = arm::Row<N, X>[In::count];

  DriveTables(const arm::Numbers<S, X>& numbers, const Make& maker) : make_(maker), n_(numbers) {
    fill();
  }
  // With joints in the given modes.
  DriveTables(const arm::Numbers<S, X>& numbers, const Make& maker, const Modes (&modes)[N])
      : make_(maker), n_(numbers) {
    rest();
    n_.for_each_drive([&](const auto& drive, int j) {
      now_[j] = modes[j];
      put_offsets(j);
      keep(LinearDrive<K, M>::of(drive, modes[j].held()), j);
    });
    retime(maker);
  }
  // For steps of another length, in the same modes.
  void retime(const Make& maker) {
    make_ = maker;
    for (int g = 0; g < arm::Row<N, X>::groups; ++g)
      copy(make_.template operator()<R>(drives_[g]), g);
  }
  static_assert(!any_drive<S>([](const auto& drive) {
    return !LinearDrive<K, M>::is_sound(drive);
  }),
                "a part of a drive calls linear what is not, and the schemes would leave it out");

  // The numbers of a lane have changed.
  void renew(int lane) {
    if constexpr (own) fill_lane(lane);
  }
  // All numbers have changed.
  void fill() {
    for (int lane = 0; lane < (own ? width : 1); ++lane) fill_lane(lane);
  }
  // The same for one lane. All parts are in their usual modes.
  void fill_lane(int lane) {
    n_.for_each_drive_of(lane, [&](const auto& drive, int j) {
      if constexpr (modal) {
        now_[j] = {};
        put_offsets(j);
      }
      copy(table_of(drive, 0, j), j, lane);
    });
  }

  // Put joint j into these modes.
  void serve(int j, const Modes& modes) {
    const unsigned held = modes.held();
    if (held != now_[j].held()) change_table(j, held);
    now_[j] = modes;
    put_offsets(j);
  }
  const Modes& served(int j) const { return now_[j]; }
  // The same for the drive of a joint, as it counts its modes.
  auto modes() const {
    return [this]<class Drive>(const Drive&, int j, int) {
      if constexpr (modal && Drive::modes > 0)
        return resized<Drive::modes>(now_[j]);
      else
        return typename Drive::Modes{};
    };
  }
  // Whether all joints are served in their usual modes.
  bool serves_usual() const {
    bool usual = true;
    for (const Modes& modes : now_) usual = usual && modes == Modes{};
    return usual;
  }

  // The numbers of the modes that are in use.
  ARM_INLINE void put_modes(Inputs& in) const {
    for_each<M, kMostInputs>([&](auto m) __attribute__((always_inline)) {
      in[In::offset + m] = arm::Row<N, X>::load(offsets_[m]);
    });
  }

  // The rest of every drive, in the rows of f and in g.
  struct Rest {
    alignas(64) X at[R][row] = {};

    ARM_INLINE void put(Inputs& in) const {
      for_each<R, kMostInputs>([&](auto r) __attribute__((always_inline)) {
        in[In::rest + r] = arm::Row<N, X>::gather(at[r]);
      });
    }
  };

  // That at x, in the modes that are in use.
  ARM_INLINE Rest rest_at(const State<S, X>& x, const X (&u)[row]) const {
    Rest rest;
    if constexpr (own) {
      for (int lane = 0; lane < width; ++lane)
        n_.for_each_drive_of(lane, [&]<class Drive>(const Drive& drive, int j) {
          if constexpr (!Drive::is_linear) put_rest(drive, j, lane, x, u, rest);
        });
    } else if constexpr (modal) {
      n_.for_each_drive_of(0, [&]<class Drive>(const Drive& drive, int j) {
        if constexpr (!Drive::is_linear) put_rest(drive, j, 0, x, u, rest);
      });
    } else {
      n_.for_each_drive_of(
          0, [&]<class Drive>(const Drive& drive, int j) __attribute__((always_inline)) {
            if constexpr (!Drive::is_linear) {
              const auto is = drive.rest(input_of(drive, j, x, u[j]), 0);
              for (int k = 0; k < drive.states; ++k) rest.at[k][j] = is.f[k];
              rest.at[K][j] = is.g;
            }
          });
    }
    return rest;
  }

  // State of joint j after a step of the paper's scheme from `start`, in the modes in use.
  template <class TheDrive, class Input>
  Input end_of(const TheDrive& drive, int j, const Input& start) const {
    const Modes& modes = now_[j];
    Input end = start;
    for (int k = 0; k < TheDrive::states; ++k) {
      const auto number = [&](int input) { return dz[k][input][j]; };
      for (int m = 0; m < TheDrive::states; ++m) end.z[k] += number(m) * start.z[m];
      end.z[k] += number(In::q) * start.q + number(In::v) * start.v + number(In::u) * start.u;
      for (int m = 0; m < TheDrive::modes; ++m)
        end.z[k] += number(In::offset + m) * modes.at[m].offset;
    }
    if constexpr (!TheDrive::is_linear) {
      const auto rest =
          drive.rest(drive.with(start, resized<TheDrive::modes>(modes)), modes.held());
      for (int k = 0; k < TheDrive::states; ++k) {
        for (int r = 0; r < TheDrive::states; ++r) end.z[k] += dz[k][In::rest + r][j] * rest.f[r];
        end.z[k] += dz[k][In::rest + K][j] * rest.g;
      }
    }
    return end;
  }

  // Set x to the values that the modes in use hold, against rounding.
  void settle(State<S, X>& x, const X (&u)[row]) const {
    n_.for_each_drive([&]<class Drive>(const Drive& drive, int j) {
      if constexpr (Drive::modes > 0) {
        auto at = input_of(drive, j, x, u[j]);
        drive.settle(at, resized<Drive::modes>(now_[j]));
        put_states(drive, j, 0, at, x);
      }
    });
  }

  // A row's numbers times the inputs, for all joints.
  template <int inputs>
  ARM_INLINE static arm::Row<N, X> answer(const Numbers& numbers, const Inputs& x) {
    using Row = arm::Row<N, X>;
    Row out;
    for_each<Row::groups>([&](auto g) __attribute__((always_inline)) {
      out.at[g] = group_of(numbers[In::v], g) * x[In::v].at[g];
      for_each<inputs, kMostInputs>([&](auto input) __attribute__((always_inline)) {
        if (input != In::v && matters(input))
          out.at[g] += group_of(numbers[input], g) * x[input].at[g];
      });
    });
    return out;
  }

  // Whether any drive of this scene depends on an input.
  static constexpr bool matters(int input) {
    switch (input) {
      case In::q:
        return any_drive<S>([](const auto& d) { return d.elastic || d.has_extras; });
      case In::u:
        return any_drive<S>([](const auto& d) { return d.driven; });
      default:
        return true;
    }
  }

  alignas(64) Numbers rhs_1 = {}, rhs_2 = {}, dz[K > 0 ? K : 1] = {};
  alignas(64) Numbers k_z[linear ? 1 : K] = {};
  alignas(64) Number diagonal[row] = {};

 private:
  // Numbers that are the same for all lanes are taken one by one.
  ARM_INLINE static auto group_of(const Number (&numbers)[row], int g) {
    using Row = arm::Row<N, X>;
    if constexpr (std::is_same_v<Number, typename Row::Vector> || kWidth<X> > 1)
      return numbers[g];
    else
      return *reinterpret_cast<const typename Row::Vector*>(numbers + g * Row::group);
  }

  template <class Drive>
  void put_rest(const Drive& drive, int j, int lane, const State<S, X>& x, const X (&u)[row],
                Rest& rest) const {
    const auto now = modes()(drive, j, lane);
    const auto is = drive.rest(drive.with(input_in_lane(drive, j, x, u[j], lane), now), now.held());
    for (int k = 0; k < drive.states; ++k) set_lane(rest.at[k][j], lane, is.f[k]);
    set_lane(rest.at[K][j], lane, is.g);
  }

  void keep(const LinearDrive<K, M>& one, int j) {
    if constexpr (retimed) drives_[j / Side::group].put(j % Side::group, one);
  }
  void rest() {
    if constexpr (retimed)
      for (Drives& drives : drives_) drives = Drives::none();
  }
  template <class TheDrive>
  ARM_APART DriveTable<K, M, R> table_of(const TheDrive& drive, unsigned held, int j) {
    const LinearDrive<K, M> linear = LinearDrive<K, M>::of(drive, held);
    keep(linear, j);
    return make_.template operator()<R>(linear);
  }
  ARM_APART void change_table(int joint, unsigned held) {
    n_.for_each_drive([&](const auto& drive, int j) {
      if (j == joint) copy(table_of(drive, held, j), j, 0);
    });
  }
  void put_offsets(int j) {
    for (int m = 0; m < M; ++m) offsets_[m][j] = now_[j].at[m].offset;
  }

  void copy(const DriveTable<K, M, R>& table, int j, int lane) {
    for (int input = 0; input < In::count; ++input) {
      set_lane(rhs_1[input][j], lane, table.rhs_1[input]);
      set_lane(rhs_2[input][j], lane, table.rhs_2[input]);
      for (int k = 0; k < K; ++k) set_lane(dz[k][input][j], lane, table.dz[k][input]);
      if constexpr (!linear)
        for (int k = 0; k < K; ++k) set_lane(k_z[k][input][j], lane, table.k_z[k][input]);
    }
    set_lane(diagonal[j], lane, table.diagonal);
  }

  // The tables of a group of joints.
  void copy(const DriveTable<K, M, R, typename arm::Row<N, X>::Vector>& table, int g) {
    const auto put = [g](const auto& vector, Number(&numbers)[row]) {
      for (int j = 0; j < Side::group; ++j) numbers[g * Side::group + j] = vector[j];
    };
    for (int input = 0; input < In::count; ++input) {
      put(table.rhs_1[input], rhs_1[input]);
      put(table.rhs_2[input], rhs_2[input]);
      for (int k = 0; k < K; ++k) put(table.dz[k][input], dz[k][input]);
      if constexpr (!linear)
        for (int k = 0; k < K; ++k) put(table.k_z[k][input], k_z[k][input]);
    }
    put(table.diagonal, diagonal);
  }

  using Side = arm::Row<N, X>;
  Make make_;
  const arm::Numbers<S, X>& n_;
  static constexpr bool retimed = S::events == Events::located && width == 1;
  using Drives = LinearDrive<K, M, typename Side::Vector>;
  Drives drives_[retimed ? Side::groups : 1];
  Modes now_[N];
  alignas(64) X offsets_[modal ? M : 1][row] = {};
};

}  // namespace arm
