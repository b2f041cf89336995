// The numbers of a machine: constants of its scene, and those that the scene lists as varied, which
// every machine has for itself and which may be set between two steps.
//
// What is asked for here is a constant wherever no varied number can reach it: which of the links'
// base parameters one reaches is found out by trying it.
#pragma once

#include "base_parameters.hpp"

namespace arm {

// All numbers that follow from the varied ones.
template <class S>
struct Sheet {
  decltype(S::drives(nullptr)) drives;
  BaseParameters<S::N> base;
  double carried[S::N] = {};  // inertia of the rotors that turn with their links, as these feel it
  double Dc[S::N] = {}, Ds[S::N] = {};

  constexpr explicit Sheet(const double* p) : drives(S::drives(p)), base(S::links(p).at) {
    [&]<int... j>(std::integer_sequence<int, j...>) {
      (set(j, std::get<j>(drives)), ...);
    }(std::make_integer_sequence<int, S::N>{});
  }

 private:
  constexpr void set(int j, const auto& drive) {
    carried[j] = drive.carried();
    Dc[j] = drive.friction.Dc;
    Ds[j] = drive.friction.Ds;
  }
};

// A sheet of some values of the varied numbers, with one of them changed; -1: none.
template <class S>
constexpr Sheet<S> sheet_with(int changed) {
  SomeValues<S> values;
  if (changed >= 0) values.p[changed] *= 1.5;
  return Sheet<S>(values.p);
}

// Which of a body's numbers depend on what is varied.
struct BodyMask {
  bool m = false, hx = false, hy = false, hz = false;
  bool xx = false, yy = false, zz = false, xy = false, xz = false, yz = false;
};

template <class S>
struct VariedBodies {
  BodyMask at[S::N] = {};

  constexpr VariedBodies() {
    const Sheet<S> one = sheet_with<S>(-1);
    for (int k = 0; k < S::parameters; ++k) {
      const Sheet<S> other = sheet_with<S>(k);
      for (int j = 0; j < S::N; ++j) {
        const Body<double>&a = one.base.body[j], &b = other.base.body[j];
        BodyMask& mask = at[j];
        mask.m |= a.m != b.m;
        mask.hx |= a.h.x != b.h.x, mask.hy |= a.h.y != b.h.y, mask.hz |= a.h.z != b.h.z;
        mask.xx |= a.I.xx != b.I.xx, mask.yy |= a.I.yy != b.I.yy, mask.zz |= a.I.zz != b.I.zz;
        mask.xy |= a.I.xy != b.I.xy, mask.xz |= a.I.xz != b.I.xz, mask.yz |= a.I.yz != b.I.yz;
      }
    }
  }
};

template <class S>
class Numbers {
 public:
  static constexpr int N = S::N;
  static constexpr bool varied = S::parameters > 0;

  // Of the values of the varied numbers.
  constexpr explicit Numbers(const double* values) : sheet(values) {
    for (int k = 0; k < S::parameters; ++k) p[k] = values[k];
  }

  double value(int k) const { return p[k]; }
  // Set a varied number: the caller has seen to its bounds.
  void set(int k, double value) {
    p[k] = value;
    sheet = Sheet<S>(p);
  }

  // body(drive, j) for the drive of every joint.
  template <class TheBody>
  ARM_INLINE constexpr void for_each_drive(TheBody&& body) const {
    [&]<int... j>(std::integer_sequence<int, j...>) __attribute__((always_inline)) {
      (body(std::get<j>(now().drives), j), ...);
    }(std::make_integer_sequence<int, N>{});
  }

  // A link in base parameters.
  template <class Index>
  ARM_INLINE constexpr Body<double> body(Index i) const {
    Body<double> body = kConstant.base.body[i];
    if constexpr (varied) {
      const Body<double>& own = sheet.base.body[i];
      const BodyMask& mask = kVaried.at[i];
      if (mask.m) body.m = own.m;
      if (mask.hx) body.h.x = own.h.x;
      if (mask.hy) body.h.y = own.h.y;
      if (mask.hz) body.h.z = own.h.z;
      if (mask.xx) body.I.xx = own.I.xx;
      if (mask.yy) body.I.yy = own.I.yy;
      if (mask.zz) body.I.zz = own.I.zz;
      if (mask.xy) body.I.xy = own.I.xy;
      if (mask.xz) body.I.xz = own.I.xz;
      if (mask.yz) body.I.yz = own.I.yz;
    }
    return body;
  }
  constexpr const Body<double>& fixed() const { return now().base.fixed; }

  ARM_INLINE constexpr double carried(int j) const { return now().carried[j]; }
  ARM_INLINE constexpr double Dc(int j) const { return now().Dc[j]; }
  ARM_INLINE constexpr double Ds(int j) const { return now().Ds[j]; }

 private:
  static constexpr Sheet<S> kConstant = sheet_with<S>(-1);
  static constexpr VariedBodies<S> kVaried = {};

  ARM_INLINE constexpr const Sheet<S>& now() const {
    if constexpr (varied)
      return sheet;
    else
      return kConstant;
  }

  double p[S::parameters + 1] = {};
  Sheet<S> sheet;
};

}  // namespace arm
