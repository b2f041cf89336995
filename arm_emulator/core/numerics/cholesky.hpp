// M x = b for a symmetric positive definite M, by factors with ones on their diagonals: U D U^T of
// few joints, L D L^T of many.
//
// A pattern names the entries that are not zero. U D U^T of a tree whose parents come before their
// children makes no further ones (Featherstone, Rigid Body Dynamics Algorithms, ch. 6.5).
#pragma once

#include "numerics/fma.hpp"

namespace arm {

// The upper triangle is set, row <= column; what else there is in its rows has no meaning.
template <int N, class X>
using Symmetric = X[N][kPadded<N>];

// The pattern of a full matrix.
template <int N>
struct Full {
  static constexpr bool from_the_tip = N <= kUnrollNested;
  static constexpr bool is_coupled(int, int) { return true; }
};

// No row and column is left out of a factorisation.
struct NoneLeftOut {
  constexpr bool operator()(int) const { return false; }
};

// U D U^T, from the tip to the base: the order in which the recursions of the links deliver M and
// the right-hand side. The first eliminations therefore do not wait for the last rows.
template <int N, class X, class Pattern>
struct FromTheTip {
  X U[N][N];  // -U[k][i] is row i, column k of the factor, i < k
  X inverse_D[N];

  // Factor M. Rows and columns that `is_left_out` are those of the identity. What is worked on is
  // local, so that the compiler may keep it in registers.
  template <class LeftOut = NoneLeftOut>
  ARM_INLINE void factor(const Symmetric<N, X>& M, LeftOut&& is_left_out = {}) {
    Symmetric<N, X> rest;
    for_each<N>([&](auto i) __attribute__((always_inline)) {
      for_each_from<N>(i, [&](auto j) __attribute__((always_inline)) { rest[i][j] = M[i][j]; });
    });
    for_each_reverse<N>([&](auto k) __attribute__((always_inline)) {
      const bool out = is_left_out(k);
      const X inverse = out ? X{} + 1.0 : 1.0 / rest[k][k];
      inverse_D[k] = inverse;
      for_each_reverse<k>([&](auto i) __attribute__((always_inline)) {
        if constexpr (Pattern::is_coupled(i, k)) {
          if (out || is_left_out(i)) {
            U[k][i] = X{};
            return;
          }
          const X factor = rest[i][k] * -inverse;
          U[k][i] = factor;
          for_each_from<k>(i, [&](auto j) __attribute__((always_inline)) {
            if constexpr (Pattern::is_coupled(j, k))
              rest[i][j] = fma(factor, rest[j][k], rest[i][j]);
          });
        }
      });
    });
  }

  // Rows that are left out get 0.
  template <class Y, class LeftOut = NoneLeftOut>
  ARM_INLINE void solve(Y* x, LeftOut&& is_left_out = {}) const {
    Y y[N];
    for_each<N>([&](auto k) __attribute__((always_inline)) { y[k] = x[k]; });
    for_each_reverse<N>([&](auto k) __attribute__((always_inline)) {
      if (is_left_out(k)) {
        y[k] = Y{};
        return;
      }
      for_each_reverse<k>([&](auto i) __attribute__((always_inline)) {
        if constexpr (Pattern::is_coupled(i, k)) y[i] = fma(U[k][i], y[k], y[i]);
      });
    });
    for_each<N>([&](auto k) __attribute__((always_inline)) {
      if (is_left_out(k)) {
        x[k] = Y{};
        return;
      }
      Y sum = y[k] * inverse_D[k];
      for_each<k>([&](auto i) __attribute__((always_inline)) {
        if constexpr (Pattern::is_coupled(i, k)) sum = fma(U[k][i], y[i], sum);
      });
      x[k] = y[k] = sum;
    });
  }
};

// L D L^T, from the base to the tip: all loops run along rows, and fill vectors.
template <int N, class X = Real>
struct InRows {
  alignas(64) X L[N][kPadded<N>];  // -L[j][k] is row k, column j of the factor, k > j
  X inverse_D[N];

  // Factor `M`, which is used up.
  ARM_INLINE void factor(Symmetric<N, X>& M) {
    for_each<N, kUnrollNested>([&](auto j) __attribute__((always_inline)) {
      inverse_D[j] = 1.0 / M[j][j];
      for_each_lane_from<N>(next(j), [&](auto k) __attribute__((always_inline)) {
        L[j][k] = M[j][k] * -inverse_D[j];
      });
      for_each_from<N>(next(j), [&](auto k) __attribute__((always_inline)) {
        for_each_lane_from<N>(k, [&](auto i) __attribute__((always_inline)) {
          M[k][i] = fma(L[j][k], M[j][i], M[k][i]);
        });
      });
    });
  }

  template <class Y>
  ARM_INLINE void solve(Y* x) const {
    for_each<N>([&](auto j) __attribute__((always_inline)) {
      for_each_from<N>(
          next(j), [&](auto k) __attribute__((always_inline)) { x[k] = fma(L[j][k], x[j], x[k]); });
    });
    for_each_reverse<N>([&](auto j) __attribute__((always_inline)) {
      Y sum = x[j] * inverse_D[j];
      for_each_from<N>(
          next(j), [&](auto k) __attribute__((always_inline)) { sum = fma(L[j][k], x[k], sum); });
      x[j] = sum;
    });
  }
};

template <int N, class X, class Pattern>
using Factors = std::conditional_t<Pattern::from_the_tip, FromTheTip<N, X, Pattern>, InRows<N, X>>;

template <int N, class X = Real, class Pattern = Full<N>>
struct Cholesky : Factors<N, X, Pattern> {};

// Factors of numbers with derivatives. The derivatives of x follow from M dx = db - dM x: only
// values are factored.
template <int N, int directions, class Pattern>
struct Cholesky<N, Dual<directions>, Pattern> {
  using X = Dual<directions>;
  using Row = typename X::Row;
  Factors<N, double, Pattern> of_values;
  Row dM[N][N];  // row <= column

  ARM_INLINE void factor(const Symmetric<N, X>& M) {
    alignas(64) Symmetric<N, double> values = {};
    for (int j = 0; j < N; ++j)
      for (int k = j; k < N; ++k) values[j][k] = M[j][k].value, dM[j][k] = M[j][k].by;
    of_values.factor(values);
  }
  ARM_INLINE void solve(X* x) const {
    double values[N];
    Lanes<directions> by[N];
    for (int j = 0; j < N; ++j) values[j] = x[j].value, by[j] = x[j].by;
    of_values.solve(values);
    for (int j = 0; j < N; ++j) {
      by[j] -= dM[j][j] * values[j];
      for (int k = j + 1; k < N; ++k) {
        if (!Pattern::is_coupled(j, k)) continue;
        by[j] -= dM[j][k] * values[k];
        by[k] -= dM[j][k] * values[j];
      }
    }
    of_values.solve(by);
    for (int j = 0; j < N; ++j) x[j] = {values[j], by[j]};
  }
};

}  // namespace arm
