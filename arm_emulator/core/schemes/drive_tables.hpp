// The drives' parts of a step for all joints, side by side in vectors (drive_table.hpp).
#pragma once

#include "schemes/drive_table.hpp"

namespace arm {

// Loops over states and inputs of a drive are unrolled up to these.
inline constexpr int kMostStates = 16, kMostInputs = 64;

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
