// Non-smooth behaviour of a part of a drive: a current at its limit, a stuck rotor, a contact. The
// part is smooth in each of its modes.
//
// A mode selects one of two equations and has one number that enters it: the limit, the sliding
// torque, the position of a contact. Such a part has
//
//   mode_at(...)         the mode that a state calls for,
//   required_mode(...)   the one that the end of a step calls for: the same where it holds,
//   margin(...)          how far a state is from where the mode ceases to hold, negative beyond,
//   enforce_modes(...)   and puts a state where its mode holds it, against rounding.
//   is_regular(...)        Optional and faster: whether a state, as the start
//                        and as the end of a step, surely calls for the regular mode, number 0.
#pragma once

#include "numerics/real.hpp"

namespace arm {

struct Mode {
  bool active = false;  // the equation that takes the place of the usual one
  Real offset = 0.0;    // the number that enters

  constexpr bool operator==(const Mode&) const = default;
};

// The modes of one drive, of M parts that have some.
template <int M>
struct DriveModes {
  Mode at[M > 0 ? M : 1] = {};

  constexpr bool operator==(const DriveModes&) const = default;

  // A bit for each part that is held.
  constexpr unsigned active() const {
    unsigned bits = 0;
    for (int m = 0; m < M; ++m) bits |= at[m].active ? 1u << m : 0u;
    return bits;
  }
};

// The first m of them, or all of them and more that are in their regular modes: a drive has as many
// as its parts, and a scene as many as any of its drives.
template <int m, int M>
constexpr DriveModes<m> resize_modes(const DriveModes<M>& modes) {
  DriveModes<m> some;
  for (int k = 0; k < m && k < M; ++k) some.at[k] = modes.at[k];
  return some;
}

constexpr bool is_active(unsigned active, int m) { return active >> m & 1u; }

// Tolerance for rounding.
inline constexpr double kRounding = 1e-12;

}  // namespace arm
