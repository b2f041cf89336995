// M x = b for a symmetric positive definite M, as L D L^T.
#pragma once

#include "loops.hpp"

namespace arm {

template <int N>
struct Cholesky {
  double L[N][N];  // below the diagonal
  double inverse_D[N];

  // Factor the matrix whose lower triangle is in `M`.
  ARM_INLINE void factor(const double (&M)[N][N]) {
    for_each<N>([&](auto j) __attribute__((always_inline)) {
      double LD[N];
      double d = M[j][j];
      for (int k = 0; k < j; ++k) {
        LD[k] = M[j][k];
        for (int m = 0; m < k; ++m) LD[k] -= LD[m] * L[k][m];
        L[j][k] = LD[k] * inverse_D[k];
        d -= LD[k] * L[j][k];
      }
      inverse_D[j] = 1.0 / d;
    });
  }

  ARM_INLINE void solve(double (&x)[N]) const {
    for_each<N>([&](auto j) __attribute__((always_inline)) {
      for (int k = 0; k < j; ++k) x[j] -= L[j][k] * x[k];
    });
    for_each_reverse<N>([&](auto j) __attribute__((always_inline)) {
      x[j] *= inverse_D[j];
      for (int k = j + 1; k < N; ++k) x[j] -= L[k][j] * x[k];
    });
  }
};

}  // namespace arm
