// A drive's part of a step as a table of numbers, worked out from what the drive says of itself.
//
// f = F (z, q, v, u, side) + n and g = G (z, q, v) + n_g: asking the drive's linear parts for f and
// g at one unit of each input gives the columns of F and G. The rest n, of parts that are not
// linear, is an input of its own. With s = gamma h, a stage (I - s A) k = r of a linearly implicit
// scheme reads, for one joint,
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
// Nothing is divided by an inductance or a stiffness, so that D may have zeros and a gear may be as
// stiff as it likes.
#pragma once

#include "numbers.hpp"
#include "state.hpp"

namespace arm {

// Loops over states and inputs of a drive are unrolled up to these.
inline constexpr int kMostStates = 16, kMostInputs = 64;

// What a joint's part of a step is linear in: z, q, v, u, side, the drive's rest at the step's
// start in the rows of f and in g, the acceleration of the link in the first stage, how the rest
// changes in it, and the acceleration in the second. R is K + 1, or 0 where all drives are linear.
template <int K, int R>
struct StepInput {
  static constexpr int q = K, v = K + 1, u = K + 2, side = K + 3, rest = K + 4;
  static constexpr int k1 = rest + R, change = k1 + 1, k2 = change + R, count = k2 + 1;
};

// F and G of one drive, its states in rows of K; a state that it does not have rests.
template <int K>
struct LinearDrive {
  static constexpr int kRows = K > 0 ? K : 1;
  double D[kRows], F[kRows][K + 4], G[K + 4];

  template <class TheDrive>
  ARM_ONCE static constexpr LinearDrive of(const TheDrive& whole, bool limited) {
    using Input = DriveInput<TheDrive::states, double>;
    LinearDrive linear = {};
    const auto drive = whole.linear();
    const auto D = drive.D(limited);
    for (int k = 0; k < K; ++k) linear.D[k] = k < TheDrive::states ? D.f[k] : 1.0;
    for (int column = 0; column < K + 4; ++column) {
      Input one = {};
      if (column < K) {
        if (column >= TheDrive::states) continue;
        one.z[column] = 1.0;
      } else {
        double* const rest[] = {&one.q, &one.v, &one.u, &one.side};
        *rest[column - K] = 1.0;
      }
      const auto rates = drive.rates(one, limited);
      for (int k = 0; k < TheDrive::states; ++k) linear.F[k][column] = rates.f[k];
      linear.G[column] = rates.g;
    }
    return linear;
  }

  // Whether what a drive's parts call linear is: asked at a sum of inputs it gives the sum of its
  // answers.
  template <class TheDrive>
  static constexpr bool is_sound(const TheDrive& whole, bool limited) {
    const LinearDrive linear = of(whole, limited);
    const auto drive = whole.linear();
    DriveInput<TheDrive::states, double> x = {};
    double input[K + 4] = {};
    for (int column = 0; column < K + 4; ++column)
      input[column] = column < K && column >= TheDrive::states ? 0.0 : 1.0 + 0.37 * column;
    for (int k = 0; k < TheDrive::states; ++k) x.z[k] = input[k];
    x.q = input[K], x.v = input[K + 1], x.u = input[K + 2], x.side = input[K + 3];
    const auto rates = drive.rates(x, limited);
    const auto agrees = [&](double answer, const double (&row)[K + 4]) {
      double sum = 0.0, size = 0.0;
      for (int column = 0; column < K + 4; ++column) {
        sum += row[column] * input[column];
        size += magnitude(row[column] * input[column]);
      }
      return magnitude(answer - sum) <= 1e-9 * size;
    };
    bool all = agrees(rates.g, linear.G);
    for (int k = 0; k < TheDrive::states; ++k) all = all && agrees(rates.f[k], linear.F[k]);
    return all;
  }

  // E = (D - s F_z)^-1, by Gauss and Jordan with pivots.
  constexpr void inverse(double s, double (&E)[kRows][kRows]) const {
    double W[kRows][kRows] = {};
    for (int r = 0; r < K; ++r)
      for (int c = 0; c < K; ++c) {
        W[r][c] = (r == c ? D[r] : 0.0) - s * F[r][c];
        E[r][c] = r == c ? 1.0 : 0.0;
      }
    for (int c = 0; c < K; ++c) {
      int pivot = c;
      for (int r = c + 1; r < K; ++r)
        if (magnitude(W[r][c]) > magnitude(W[pivot][c])) pivot = r;
      for (int m = 0; m < K; ++m) {
        const double w = W[c][m], e = E[c][m];
        W[c][m] = W[pivot][m], E[c][m] = E[pivot][m];
        W[pivot][m] = w, E[pivot][m] = e;
      }
      const double scale = 1.0 / W[c][c];
      for (int m = 0; m < K; ++m) W[c][m] *= scale, E[c][m] *= scale;
      for (int r = 0; r < K; ++r) {
        if (r == c) continue;
        const double factor = W[r][c];
        for (int m = 0; m < K; ++m) W[r][m] -= factor * W[c][m], E[r][m] -= factor * E[c][m];
      }
    }
  }
};

// One joint's part of a step of size h: what each row is, to one unit of each input.
template <int K, int R>
struct DriveTable {
  using In = StepInput<K, R>;
  static constexpr int kRows = K > 0 ? K : 1;
  double rhs_1[In::count];                   // of the link's row: (M + diagonal) k1 = rhs_1 - nle
  double rhs_2[In::count];                   // (M + diagonal) k2 = rhs_2 - sqrt(2) nle
  double dz[kRows][In::count];               // what the step adds to z
  double diagonal;                           // s b
  double k_z[R > 0 ? kRows : 1][In::count];  // the rates of z in the first stage
};

inline constexpr double kSqrt2 = 1.4142135623730951;

// gamma of the scheme with so many stages: implicit Euler's, and ROS2's.
constexpr double gamma_of(int stages) { return stages == 2 ? 1.0 - 0.5 * kSqrt2 : 1.0; }

// The table of a linearly implicit scheme with 1 or 2 stages (linearly_implicit.hpp).
template <int K, int R>
ARM_ONCE DriveTable<K, R> implicit_table(const LinearDrive<K>& drive, double h, int stages) {
  using In = StepInput<K, R>;
  constexpr int n = LinearDrive<K>::kRows;
  const double s = gamma_of(stages) * h;
  double E[n][n] = {}, e[n] = {};
  drive.inverse(s, E);
  for (int r = 0; r < K; ++r)
    for (int c = 0; c < K; ++c) e[r] += s * E[r][c] * (drive.F[c][In::v] + s * drive.F[c][In::q]);
  double b = -(s * drive.G[In::q] + drive.G[In::v]);
  for (int k = 0; k < K; ++k) b -= drive.G[k] * e[k];

  DriveTable<K, R> table = {};
  table.diagonal = s * b;
  // What is left of a stage when z is eliminated: rhs of the link's row, then k_z from k_v.
  struct Stage {
    double z[n], rhs;
  };
  const auto eliminate = [&](const double (&r_z)[n], double r_q, double r_v) {
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
    double f[n] = {}, g = 0.0;
    for (int column = 0; column < K + 4; ++column) {
      for (int k = 0; k < K; ++k) f[k] += drive.F[k][column] * x[column];
      g += drive.G[column] * x[column];
    }
    if constexpr (R > 0) {
      for (int k = 0; k < K; ++k) f[k] += x[In::rest + k];
      g += x[In::rest + K];
    }
    const Stage one = eliminate(f, x[In::v], g);
    double k_z[n] = {};
    for (int k = 0; k < K; ++k) k_z[k] = one.z[k] + e[k] * x[In::k1];
    table.rhs_1[input] = one.rhs;
    if constexpr (R > 0)
      for (int k = 0; k < K; ++k) table.k_z[k][input] = k_z[k];
    if (stages == 1) {
      for (int k = 0; k < K; ++k) table.dz[k][input] = h * k_z[k];
      continue;
    }
    double r_z[n] = {};
    for (int k = 0; k < K; ++k) r_z[k] = kSqrt2 * drive.D[k] * k_z[k];
    double r_v = kSqrt2 * (one.rhs - s * b * x[In::k1]);
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

// The table of the paper's scheme: backward Euler of the drive with the link held; `rhs_1` is the
// torque on the link at the states after it. The drive's rest stays what it is at the step's start.
template <int K, int R>
ARM_ONCE DriveTable<K, R> paper_table(const LinearDrive<K>& drive, double h) {
  using In = StepInput<K, R>;
  constexpr int n = LinearDrive<K>::kRows;
  double E[n][n] = {};
  drive.inverse(h, E);
  DriveTable<K, R> table = {};
  for (int input = 0; input < K + 4; ++input) {
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

// The tables of all joints, side by side, so that a row is worked out for all of them at once.
template <class S, class X>
class DriveTables {
 public:
  static constexpr int N = S::N, K = most_states<S>(), row = kRow<N, X>;
  static constexpr bool linear = !any_drive<S>([](const auto& d) { return !d.is_linear; });
  static constexpr int R = linear ? 0 : K + 1;
  using In = StepInput<K, R>;
  static constexpr bool limits = any_drive<S>([](const auto& d) { return d.motor.has_limit(); });
  static constexpr int width = kWidth<X>;
  // Lanes may have drives of their own, and be at their limits each in its own way.
  static constexpr bool own = arm::Numbers<S, X>::varied && width > 1;
  using Number = std::conditional_t<limits || own, X, double>;

  // For each input a row of numbers.
  using Numbers = Number[In::count][row];
  using Inputs = arm::Row<N, X>[In::count];

  // `make(linear drive)` gives a joint's table.
  template <class Make>
  DriveTables(const arm::Numbers<S, X>& numbers, Make&& make) : n(numbers) {
    fill(make);
  }
  static_assert(!any_drive<S>([](const auto& drive) {
    return !LinearDrive<K>::is_sound(drive, false) || !LinearDrive<K>::is_sound(drive, true);
  }),
                "a part of a drive calls linear what is not, and the schemes would leave it out");

  // The same, when the numbers have changed.
  template <class Make>
  void fill(Make&& make) {
    for (int lane = 0; lane < width; ++lane) fill_lane(lane, make);
  }
  // The same for one lane.
  template <class Make>
  void fill_lane(int lane, Make&& make) {
    n.for_each_drive_of(lane, [&](const auto& drive, int j) {
      DriveTable<K, R>* of = of_joint[own ? lane : 0][j];
      of[0] = make(LinearDrive<K>::of(drive, false));
      if constexpr (limits) of[1] = make(LinearDrive<K>::of(drive, true));
      set_lane(served[j], lane, 0.0);
      copy(of[0], j, lane);
    });
  }

  // Use the table of joint j for a current at the limit `side`, or for one within if it is 0.
  void serve(int j, int lane, double side) {
    if ((side != 0.0) != (lane_of(served[j], lane) != 0.0))
      copy(of_joint[own ? lane : 0][j][side != 0.0], j, lane);
    set_lane(served[j], lane, side);
  }
  double served_side(int j, int lane) const { return lane_of(served[j], lane); }
  ARM_INLINE arm::Row<N, X> sides() const { return arm::Row<N, X>::load(served); }

  // The rest of every drive, in the rows of f and in g.
  struct Rest {
    alignas(64) X at[R][row] = {};

    ARM_INLINE void put(Inputs& in) const {
      for_each<R, kMostInputs>([&](auto r) __attribute__((always_inline)) {
        in[In::rest + r] = arm::Row<N, X>::gather(at[r]);
      });
    }
  };

  // That at x, with currents at the limits `side` or within where it is 0.
  ARM_INLINE Rest rest_at(const State<S, X>& x, const X (&u)[row], const X (&side)[row]) const {
    Rest rest;
    if constexpr (own) {
      for (int lane = 0; lane < width; ++lane)
        n.for_each_drive_of(lane, [&](const auto& drive, int j) {
          if constexpr (!drive.is_linear) {
            auto at = input_in_lane(drive, j, x, u[j], lane);
            at.side = lane_of(side[j], lane);
            const auto is = rest_of(drive, at);
            for (int k = 0; k < drive.states; ++k) set_lane(rest.at[k][j], lane, is.f[k]);
            set_lane(rest.at[K][j], lane, is.g);
          }
        });
    } else {
      n.for_each_drive_of(0, [&](const auto& drive, int j) __attribute__((always_inline)) {
        if constexpr (!drive.is_linear) {
          const auto is = rest_of(drive, input_of(drive, j, x, u[j], side[j]));
          for (int k = 0; k < drive.states; ++k) rest.at[k][j] = is.f[k];
          rest.at[K][j] = is.g;
        }
      });
    }
    return rest;
  }
  ARM_INLINE Rest rest_at(const State<S, X>& x, const X (&u)[row]) const {
    return rest_at(x, u, served);
  }

  // State k of joint j after the step, were the current free to pass its limit.
  double free_state(int k, int j, int lane, const State<S, X>& x, const X& u,
                    [[maybe_unused]] const Rest& rest) const {
    const double* number = of_joint[own ? lane : 0][j][0].dz[k];
    double z = lane_of(x.z[k][j], lane);
    for (int m = 0; m < K; ++m) z += number[m] * lane_of(x.z[m][j], lane);
    for (int r = 0; r < R; ++r) z += number[In::rest + r] * lane_of(rest.at[r][j], lane);
    return z + number[In::q] * lane_of(x.q[j], lane) + number[In::v] * lane_of(x.v[j], lane) +
           number[In::u] * lane_of(u, lane);
  }

  // What rounding has moved: a current at its limit is at it to the last bit, one within not
  // beyond.
  void settle(State<S, X>& x) const {
    for (int lane = 0; lane < width; ++lane) {
      n.for_each_drive_of(lane, [&](const auto& drive, int j) {
        if constexpr (drive.driven) {
          const double limit = drive.motor.current_limit;
          if (!drive.motor.has_limit()) return;
          const double side = lane_of(served[j], lane), i = lane_of(x.z[drive.i][j], lane);
          set_lane(x.z[drive.i][j], lane, select(side != 0.0, side * limit, clamp(i, limit)));
        }
      });
    }
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

  // Whether any drive of this scene takes notice of an input.
  static constexpr bool matters(int input) {
    switch (input) {
      case In::q:
        return any_drive<S>([](const auto& d) { return d.elastic; });
      case In::u:
        return any_drive<S>([](const auto& d) { return d.driven; });
      case In::side:
        return limits;
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

  // Of one drive, with its current within its limit or at it.
  template <class TheDrive, class Input>
  ARM_INLINE static auto rest_of(const TheDrive& drive, const Input& at) {
    auto is = drive.rest(at, false);
    if constexpr (limits) {
      const auto limited = drive.rest(at, true);
      for (int k = 0; k < drive.states; ++k)
        is.f[k] = select(at.side != 0.0, limited.f[k], is.f[k]);
      is.g = select(at.side != 0.0, limited.g, is.g);
    }
    return is;
  }

  void copy(const DriveTable<K, R>& table, int j, int lane) {
    for (int input = 0; input < In::count; ++input) {
      set_lane(rhs_1[input][j], lane, table.rhs_1[input]);
      set_lane(rhs_2[input][j], lane, table.rhs_2[input]);
      for (int k = 0; k < K; ++k) set_lane(dz[k][input][j], lane, table.dz[k][input]);
      if constexpr (!linear)
        for (int k = 0; k < K; ++k) set_lane(k_z[k][input][j], lane, table.k_z[k][input]);
    }
    set_lane(diagonal[j], lane, table.diagonal);
  }

  const arm::Numbers<S, X>& n;
  DriveTable<K, R> of_joint[own ? width : 1][N][limits ? 2 : 1];
  alignas(64) X served[row] = {};  // the side of the table in use
};

}  // namespace arm
