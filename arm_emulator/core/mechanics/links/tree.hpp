// The tree of a scene's links: which of them each one carries. A chain is the tree without a fork.
//
// Parents come before children, and each link's before those of the next: link i carries the links
// from i to before end[i], so that all that concerns a branch is one range of indices.
#pragma once

#include "mechanics/scene.hpp"
#include "numerics/cholesky.hpp"

namespace arm {

template <int L>
struct Tree {
  int parent[L] = {}, end[L] = {};
  bool forks = false;
  int pairs = 0;  // of links of which one carries the other, or the same

  constexpr explicit Tree(const Link (&link)[L]) {
    for (int i = L - 1; i >= 0; --i) {
      parent[i] = link[i].parent;
      forks |= parent[i] != i - 1;
      if (end[i] == 0) end[i] = i + 1;
      if (parent[i] >= 0 && end[parent[i]] == 0) end[parent[i]] = end[i];
      pairs += end[i] - i;
    }
  }

  // Whether link i carries link j, or j carries i.
  constexpr bool is_related(int i, int j) const { return i < j ? j < end[i] : i < end[j]; }
  constexpr bool is_leaf(int i) const { return end[i] == i + 1; }
  constexpr bool is_last_child(int i) const { return end[i] == end[parent[i]]; }
  // Whether loops over pairs are unrolled: a tree has fewer of them than a chain.
  constexpr bool is_unrolled() const {
    constexpr int limit = kUnrollNested * (kUnrollNested + 1) / 2;
    return L <= kUnrollNested || (forks && L <= kUnrollLimit && pairs <= limit);
  }
};

template <class S>
inline constexpr Tree<S::L> kTree = Tree<S::L>(kLinks<S>.at);

// Entries of the drives' mass matrix that are not zero in every pose, nor after an elimination from
// the tips.
template <class S>
struct MassPattern {
  static constexpr int N = S::N;
  static constexpr bool dense = !kTree<S>.forks;
  static constexpr bool from_the_tip =
      N <= kUnrollNested || (kTree<S>.forks && kTree<S>.is_unrolled() && N <= kUnrollLimit);

  struct Table {
    bool at[N][N] = {};
    constexpr Table() {
      for (int i = 0; i < S::L; ++i)
        for (int k = 0; k < S::L; ++k)
          if (kTree<S>.is_related(i, k)) set(i, k);
      for (int k = N - 1; k >= 0; --k)
        for (int i = 0; i < k; ++i)
          for (int j = 0; j < k; ++j) at[i][j] |= at[i][k] && at[j][k];
    }

   private:
    constexpr void set(int i, int k) {
      if constexpr (kCoupled<S>) {
        for (int j = 0; j < N; ++j)
          for (int m = 0; m < N; ++m)
            at[j][m] |= S::coupling[i][j] != 0.0 && S::coupling[k][m] != 0.0;
      } else {
        at[i][k] = true;
      }
    }
  };
  static constexpr Table table = {};

  static constexpr bool is_coupled(int i, int k) { return dense || table.at[i][k]; }
};

template <class S, class X = Real>
using MassFactors = Cholesky<S::N, X, MassPattern<S>>;

}  // namespace arm
