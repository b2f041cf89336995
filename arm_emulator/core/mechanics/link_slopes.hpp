// The links' part at a state with its derivatives by positions and speeds, of which those in other
// directions follow: taken once for all of them.
#pragma once

#include "mechanics/links.hpp"
#include "mechanics/state.hpp"

namespace arm {

template <class S>
class LinkSlopes {
 public:
  static constexpr int N = S::N, width = sizeof(Real) / sizeof(double) - 1;
  using Dynamics = typename Links<S>::Dynamics;

  // `values`: the machine's numbers, without derivatives.
  void take(const Numbers<S>& values, const State<S>& x) {
    for (int first = 0; first < 2 * N; first += width) {
      Real q[N], v[N];
      for (int j = 0; j < N; ++j) q[j] = x.q[j].value, v[j] = x.v[j].value;
      for (int i = first; i < 2 * N && i < first + width; ++i)
        (i < N ? q[i] : v[i - N]).by[i - first] = 1.0;
      Links<S>::dynamics_apart(values, q, v, at_);
      for (int i = first; i < 2 * N && i < first + width; ++i)
        for (int j = 0; j < N; ++j) {
          nle_[j][i] = at_.nle[j].by[i - first];
          for (int k = j; k < N && i < N; ++k) M_[j][k][i] = at_.M.at[j][k].by[i - first];
        }
    }
  }
  // The part at x, of the same values, of a machine whose links have no derivatives of their own.
  void put(const State<S>& x, Dynamics& links) const {
    for (int j = 0; j < N; ++j) {
      links.nle[j] = at_.nle[j].value;
      for (int i = 0; i < N; ++i)
        links.nle[j].by += nle_[j][i] * x.q[i].by + nle_[j][N + i] * x.v[i].by;
      for (int k = j; k < N; ++k) {
        Real& M = links.M.at[j][k] = at_.M.at[j][k].value;
        for (int i = 0; i < N; ++i)
          if (M_[j][k][i] != 0.0) M.by += M_[j][k][i] * x.q[i].by;
      }
    }
  }
  // Whether the links of a machine have derivatives of their own.
  static bool own(const Numbers<S>& numbers, const State<S>& x) {
    Real q[N], v[N];
    for (int j = 0; j < N; ++j) q[j] = x.q[j].value + 0.1, v[j] = 1.0;
    Dynamics links;
    Links<S>::dynamics_apart(numbers, q, v, links);
    bool found = false;
    for (int j = 0; j < N; ++j) {
      found = found || has_derivatives(links.nle[j]);
      for (int k = j; k < N; ++k) found = found || has_derivatives(links.M.at[j][k]);
    }
    return found;
  }

 private:
  Dynamics at_;
  double nle_[N][2 * N], M_[N][N][N];
};

}  // namespace arm
