// The links' part at a state with its derivatives by positions and speeds, of
// which those in other directions follow: taken once for all of them.
#pragma once

#include "mechanics/links/links.hpp"
#include "mechanics/state.hpp"

namespace arm {

template <class S>
class LinkSlopes {
 public:
  static constexpr int N = S::N, width = sizeof(Real) / sizeof(double) - 1;
  using Dynamics = typename Links<S>::Dynamics;

  // `values`: the machine's numbers, without derivatives.
  void update(const Numbers<S>& values, const State<S>& x) {
    for (int first = 0; first < 2 * N; first += width) {
      Real q[N], v[N];
      for (int j = 0; j < N; ++j) q[j] = x.q[j].value, v[j] = x.v[j].value;
      for (int i = first; i < 2 * N && i < first + width; ++i)
        (i < N ? q[i] : v[i - N]).by[i - first] = 1.0;
      if (first < N)
        Links<S>::compute_dynamics_apart(values, q, v, at_);
      else
        compute_nle_apart(values, q, v, at_.nle);
      for (int i = first; i < 2 * N && i < first + width; ++i)
        for (int j = 0; j < N; ++j) {
          nle_[j][i] = at_.nle[j].by[i - first];
          for (int k = j; k < N && i < N; ++k) M_[j][k][i] = at_.M.at[j][k].by[i - first];
        }
    }
  }
  // At the state taken, without derivatives.
  double nle(int j) const { return at_.nle[j].value; }
  double M(int j, int k) const { return at_.M.entry(j, k).value; }
  // The derivatives of M a + share nle by q, and of nle by v, a row for each
  // joint.
  void by_q(const double* a, double share, double (&out)[N][N]) const {
    for (int j = 0; j < N; ++j)
      for (int i = 0; i < N; ++i) out[j][i] = share * nle_[j][i];
    for (int j = 0; j < N; ++j)
      for (int k = j; k < N; ++k)
        for (int i = 0; i < N; ++i) {
          out[j][i] += M_[j][k][i] * a[k];
          if (k != j) out[k][i] += M_[j][k][i] * a[j];
        }
  }
  void by_v(double (&out)[N][N]) const {
    for (int j = 0; j < N; ++j)
      for (int i = 0; i < N; ++i) out[j][i] = nle_[j][N + i];
  }
  // Whether the links of a machine have derivatives of their own.
  static bool has_own_slopes(const Numbers<S>& numbers, const State<S>& x) {
    Real q[N], v[N];
    for (int j = 0; j < N; ++j) q[j] = x.q[j].value + 0.1, v[j] = 1.0;
    Dynamics links;
    Links<S>::compute_dynamics_apart(numbers, q, v, links);
    bool result = false;
    for (int j = 0; j < N; ++j) {
      result = result || has_derivatives(links.nle[j]);
      for (int k = j; k < N; ++k) result = result || has_derivatives(links.M.at[j][k]);
    }
    return result;
  }

 private:
  static ARM_APART void compute_nle_apart(const Numbers<S>& n, const Real* q, const Real* v,
                                          Real* nle) {
    typename Links<S>::Kinematics kinematics;
    Links<S>::compute_kinematics(n, q, kinematics);
    Links<S>::compute_inverse_dynamics(n, kinematics, v, nullptr, nle);
  }

  Dynamics at_;
  double nle_[N][2 * N], M_[N][N][N];
};

}  // namespace arm
