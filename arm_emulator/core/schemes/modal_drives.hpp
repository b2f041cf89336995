// The drives of all joints in the modes of a step, and what the inputs of a step are.
#pragma once

#include <array>

#include "schemes/drive_table.hpp"

namespace arm {

// Loops over states and inputs of a drive are unrolled up to these.
inline constexpr int kMaxStates = 16, kMaxInputs = 64;

template <class S, class X>
class ModalDrives {
 public:
  static constexpr int N = S::N, K = max_states<S>(), row = kRow<N, X>;
  static constexpr int width = kWidth<X>;
  // Lanes have the regular modes only (lane_stepper.hpp).
  static constexpr int M = width == 1 ? max_modes<S>() : 0;
  static constexpr bool linear = !any_drive<S>([](const auto& d) { return !d.is_linear; });
  static constexpr int R = linear ? 0 : K + 1;
  using In = StepInput<K, M, R>;
  static constexpr bool modal = M > 0;
  // Lanes may have drives of their own.
  static constexpr bool own = arm::Numbers<S, X>::drives_vary && width > 1;
  // Else the tables of all groups of lanes are the same.
  static constexpr bool is_common = width > 1 && !own;
  using Number = std::conditional_t<own, X, Real>;
  using Modes = DriveModes<M>;
  // For each input a number of every joint.
  using Inputs = arm::Row<N, X>[In::count];

  explicit ModalDrives(const arm::Numbers<S, X>& numbers) : n_(numbers) {}
  static_assert(!any_drive<S>([](const auto& drive) {
    return !LinearDrive<K, M>::is_sound(drive);
  }),
                "a part of a drive calls linear what is not, and the schemes would leave it out");

  const Modes& modes_of(int j) const { return now_[j]; }
  // The modes in use of the drive of a joint, as it counts them.
  auto modes() const {
    return [this]<class Drive>(const Drive&, int j, int) {
      if constexpr (modal && Drive::modes > 0)
        return resize_modes<Drive::modes>(now_[j]);
      else
        return typename Drive::Modes{};
    };
  }
  // Whether all joints are in their regular modes.
  bool has_regular_modes() const {
    bool regular = true;
    for (const Modes& modes : now_) regular = regular && modes == Modes{};
    return regular;
  }

  // Keep the modes in use, to know them again.
  void mark_modes() { marked_ = now_; }
  bool has_marked_modes() const { return now_ == marked_; }

  // The numbers of the modes that are in use.
  ARM_INLINE void write_modes(Inputs& in) const {
    for_each<M, kMaxInputs>([&](auto m) __attribute__((always_inline)) {
      in[In::offset + m] = arm::Row<N, X>::load(offsets_[m]);
    });
  }

  // The nonlinear part of every drive, in the rows of f and in g.
  struct NonlinearParts {
    alignas(64) X at[R][row] = {};

    ARM_INLINE void write(Inputs& in) const {
      for_each<R, kMaxInputs>([&](auto r) __attribute__((always_inline)) {
        if (is_input_used(In::nonlinear + r)) in[In::nonlinear + r] = arm::Row<N, X>::gather(at[r]);
      });
    }
  };

  // The nonlinear parts at x, in the modes that are in use.
  ARM_INLINE NonlinearParts compute_nonlinear_parts(const State<S, X>& x, const X (&u)[row]) const {
    NonlinearParts nonlinear;
    if constexpr (kDifferentiates) {
      [&]<int... j>(std::integer_sequence<int, j...>) {
        (add_nonlinear_part<j>(x, u, nonlinear), ...);
      }(std::make_integer_sequence<int, N>{});
    } else if constexpr (own) {
      for (int lane = 0; lane < width; ++lane)
        n_.for_each_drive_of(lane, [&]<class Drive>(const Drive& drive, int j) {
          if constexpr (!Drive::is_linear) write_nonlinear_part(drive, j, lane, x, u, nonlinear);
        });
    } else {
      n_.for_each_drive_of(
          0, [&]<class Drive>(const Drive& drive, int j) __attribute__((always_inline)) {
            if constexpr (modal && !Drive::is_linear)
              if (!Drive::is_only_gear_nonlinear || active_[j])
                return write_nonlinear_part(drive, j, 0, x, u, nonlinear);
            if constexpr (!Drive::is_linear) {
              const auto is = drive.nonlinear_part(input_of(drive, j, x, u[j]), 0);
              for (int k = 0; k < drive.states; ++k)
                if (drive.is_nonlinear(k)) nonlinear.at[k][j] = is.f[k];
              nonlinear.at[K][j] = is.g;
            }
          });
    }
    return nonlinear;
  }

  // The nonlinear part of one drive, of numbers with derivatives, in the rows that are nonlinear.
  template <class Drive>
  ARM_APART static void compute_nonlinear_part(const Drive& drive,
                                               const typename Drive::Linear& linear,
                                               const typename Drive::template Input<X>& at,
                                               unsigned active, X* nonlinear) {
    if constexpr (!Drive::is_linear) {
      const auto put = [&](const auto& is) __attribute__((always_inline)) {
        for_each<Drive::states, kMaxStates>([&](auto k) {
          if constexpr (Drive::is_nonlinear(k)) nonlinear[k] = is.f[k];
        });
        nonlinear[K] = is.g;
      };
      if (active)
        put(drive.nonlinear_part(at, active, linear));
      else
        put(drive.nonlinear_part(at, 0, linear));
    }
  }
  template <int j>
  const auto& linear_drive() const {
    return std::get<j>(linear_);
  }

  // Set x to the values that the modes in use hold, against rounding.
  ARM_APART void enforce_modes(State<S, X>& x, const X (&u)[row]) const {
    n_.for_each_drive([&]<class Drive>(const Drive& drive, int j) {
      if constexpr (Drive::modes > 0) {
        auto at = input_of(drive, j, x, u[j]);
        drive.enforce_modes(at, resize_modes<Drive::modes>(now_[j]));
        store_states(drive, j, 0, at, x);
      }
    });
  }

  // Whether any drive of this scene depends on an input.
  static constexpr bool is_input_used(int input) {
    for (int row = 0; row < R; ++row)
      if (input == In::nonlinear + row || input == In::change + row) return is_nonlinear(row);
    switch (input) {
      case In::q:
        return any_drive<S>([](const auto& d) { return d.elastic || d.extra_count > 0; });
      case In::u:
        return any_drive<S>([](const auto& d) { return d.driven; });
      default:
        return true;
    }
  }

  // Whether the rate of state k depends on an input that matters. Lanes that share their drives
  // know by these constants; else it may.
  static constexpr bool is_rate_affected(int k, int input) { return paths.at[k][input]; }

 protected:
  // Whether any drive has a nonlinear part in a row of f, or of g.
  static constexpr bool is_nonlinear(int row) {
    return any_drive<S>([row](const auto& d) {
      return row == K ? d.is_nonlinear(d.states) : row < d.states && d.is_nonlinear(row);
    });
  }

  // All numbers have changed.
  void update_linear() {
    if constexpr (kDifferentiates) linear_ = list_linear_drives(n_.drives());
  }
  void record_modes(int j, const Modes& modes) {
    now_[j] = modes;
    active_[j] = modes.active();
    update_offsets(j);
  }

  const arm::Numbers<S, X>& n_;

 private:
  // `is_rate_affected` of all states and inputs: along the terms of the linear drives, in a table
  // (drive_table.hpp). The nonlinear part of g, and its change, enter the link's row alone.
  struct Paths {
    bool at[K > 0 ? K : 1][In::count] = {};

    constexpr Paths() {
      if constexpr (own || width == 1) {
        for (auto& of_state : at)
          for (bool& flag : of_state) flag = true;
      } else {
        std::apply([&](const auto&... drive) { (add_drive(drive), ...); },
                   Constants<S>::derived.drives);
      }
    }

   private:
    constexpr void add_drive(const auto& drive) {
      const auto linear = LinearDrive<K, M>::linearise(drive, 0);
      bool on[K > 0 ? K : 1][K > 0 ? K : 1] = {};  // of a state on others, by way of others
      for (int k = 0; k < K; ++k)
        for (int m = 0; m < K; ++m) on[k][m] = k == m || linear.F[k][m] != 0.0;
      for (int by = 0; by < K; ++by)
        for (int k = 0; k < K; ++k)
          for (int m = 0; m < K; ++m) on[k][m] |= on[k][by] && on[by][m];
      for (int k = 0; k < K; ++k)
        for (int m = 0; m < K; ++m) {
          if (!on[k][m]) continue;
          for (int input = 0; input <= In::u; ++input) at[k][input] |= linear.F[m][input] != 0.0;
          const bool link = linear.F[m][In::q] != 0.0 || linear.F[m][In::v] != 0.0;
          at[k][In::v] |= link, at[k][In::k1] |= link, at[k][In::k2] |= link;
          if constexpr (R > 0) at[k][In::nonlinear + m] = at[k][In::change + m] = true;
        }
    }
  };
  static constexpr Paths paths = {};

  template <class Drive>
  void write_nonlinear_part(const Drive& drive, int j, int lane, const State<S, X>& x,
                            const X (&u)[row], NonlinearParts& nonlinear) const {
    const auto now = modes()(drive, j, lane);
    const auto at = drive.apply_modes(input_in_lane(drive, j, x, u[j], lane), now);
    const auto put = [&](const auto& is) __attribute__((always_inline)) {
      for (int k = 0; k < drive.states; ++k) set_lane(nonlinear.at[k][j], lane, is.f[k]);
      set_lane(nonlinear.at[K][j], lane, is.g);
    };
    // The linear terms of the regular modes, which are constants, fold away.
    if (const unsigned active = now.active())
      put(drive.nonlinear_part(at, active));
    else
      put(drive.nonlinear_part(at, 0));
  }

  // The nonlinear part of joint j, of numbers with derivatives: copies of drives take longer than
  // what is done with them.
  template <int j>
  ARM_APART void add_nonlinear_part(const State<S, X>& x, const X (&u)[row],
                                    NonlinearParts& nonlinear) const {
    const auto& drive = std::get<j>(n_.drives());
    using Drive = std::remove_cvref_t<decltype(drive)>;
    if constexpr (!Drive::is_linear) {
      typename Drive::template Input<X> at;
      for_each<Drive::states, kMaxStates>([&](auto k) { at.z[k] = x.z[k][j]; });
      at.q = x.q[j], at.v = x.v[j], at.u = u[j];
      unsigned active = 0;
      if constexpr (modal) {
        for_each<Drive::modes, kMaxStates>([&](auto m) { at.offset[m] = now_[j].at[m].offset; });
        active = now_[j].active();
      }
      X is[K + 1];
      compute_nonlinear_part(drive, std::get<j>(linear_), at, active, is);
      for_each<Drive::states, kMaxStates>([&](auto k) {
        if constexpr (Drive::is_nonlinear(k)) nonlinear.at[k][j] = is[k];
      });
      nonlinear.at[K][j] = is[K];
    }
  }
  static auto list_linear_drives(const auto& drives) {
    return std::apply([](const auto&... drive) { return std::make_tuple(drive.linear()...); },
                      drives);
  }

  void update_offsets(int j) {
    for (int m = 0; m < M; ++m) offsets_[m][j] = now_[j].at[m].offset;
  }

  std::array<Modes, N> now_, marked_;
  unsigned active_[N] = {};  // of each drive
  alignas(64) X offsets_[modal ? M : 1][row] = {};
  using Linears = decltype(list_linear_drives(S::drives(nullptr)));
  [[no_unique_address]] std::conditional_t<kDifferentiates, Linears, Nothing> linear_;
};

}  // namespace arm
