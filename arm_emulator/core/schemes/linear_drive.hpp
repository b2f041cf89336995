// A drive that is linear in its inputs, as numbers: f = F (z, q, v, u, offset), g = G (...).
//
// f and g of the linear parts at a unit of each input are the columns of F and G.
#pragma once

#include "mechanics/numbers.hpp"
#include "mechanics/state.hpp"

namespace arm {

// F and G of one drive, its states in rows of K; a missing state is constant. Of numbers X that are
// several joints side by side, those of several drives.
template <int K, int M, class X = Real>
struct LinearDrive {
  static constexpr int kRows = K > 0 ? K : 1, kColumns = K + 3 + M;
  X D[kRows], F[kRows][kColumns], G[kColumns];

  // Drives at rest.
  static constexpr LinearDrive make_resting() {
    LinearDrive resting = {};
    for (X& d : resting.D) d = X{} + 1.0;
    return resting;
  }
  // Take over the numbers of one drive.
  void write_lane(int lane, const LinearDrive<K, M>& drive) {
    for (int k = 0; k < K; ++k) {
      set_lane(D[k], lane, drive.D[k]);
      for (int c = 0; c < kColumns; ++c) set_lane(F[k][c], lane, drive.F[k][c]);
    }
    for (int c = 0; c < kColumns; ++c) set_lane(G[c], lane, drive.G[c]);
  }

  template <class TheDrive>
  ARM_APART static constexpr LinearDrive linearise(const TheDrive& whole, unsigned active) {
    LinearDrive linear = {};
    const auto drive = whole.linear();
    const auto D = drive.D(active);
    for (int k = 0; k < K; ++k) linear.D[k] = k < TheDrive::states ? D.f[k] : 1.0;
    for (int column = 0; column < kColumns; ++column) {
      typename TheDrive::template Input<Real> one = {};
      if (!set_input<TheDrive>(one, column, 1.0)) continue;
      const auto rates = drive.rates(one, active);
      for (int k = 0; k < TheDrive::states; ++k) linear.F[k][column] = rates.f[k];
      linear.G[column] = rates.g;
    }
    return linear;
  }

  // Check that a drive's linear parts are linear, with all modes held and with none: f and g of a
  // sum of inputs are the sums of theirs.
  template <class TheDrive>
  static constexpr bool is_sound(const TheDrive& whole) {
    for (unsigned active = 0; active < 1u << TheDrive::modes; ++active)
      if (!is_sound(whole, active)) return false;
    return true;
  }

  // E = (D - s F_z)^-1, by Gauss and Jordan with pivots.
  ARM_INLINE constexpr void invert(Real s, X (&E)[kRows][kRows]) const {
    X W[kRows][kRows];
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
        if constexpr (!kDifferentiates)  // a factor of 0 may have some
          if (!any(factor != 0.0)) continue;
        for (int m = 0; m < K; ++m) W[r][m] -= factor * W[c][m], E[r][m] -= factor * E[c][m];
      }
    }
  }

  // Set the input of a column; false if this drive does not have it.
  template <class TheDrive>
  ARM_APART static constexpr bool set_input(typename TheDrive::template Input<Real>& x, int column,
                                            Real value) {
    if (column < K ? column >= TheDrive::states : column >= K + 3 + TheDrive::modes) return false;
    Real* const others[] = {&x.q, &x.v, &x.u};
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
  static constexpr bool is_sound(const TheDrive& whole, unsigned active) {
    const LinearDrive linear = linearise(whole, active);
    typename TheDrive::template Input<Real> x = {};
    Real input[kColumns] = {};
    for (int column = 0; column < kColumns; ++column)
      if (set_input<TheDrive>(x, column, 1.0 + 0.37 * column)) input[column] = 1.0 + 0.37 * column;
    const auto rates = whole.linear().rates(x, active);
    const auto agrees = [&](Real answer, const Real(&row)[kColumns]) {
      Real sum = 0.0, size = 0.0;
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

}  // namespace arm
