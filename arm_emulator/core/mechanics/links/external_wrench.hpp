// External wrenches on the links: on each link a force and a moment at a fixed point, held until
// they are set again. They are data of each machine.
//
// They enter the recursion of link_tree.hpp:
//
//   M(q) dv/dt + nle(q, v) = T,   nle = C(q, v) - J^T w
#pragma once

#include "numerics/real.hpp"
#include "numerics/vector3.hpp"

namespace arm {

// Force and moment about a frame's origin.
template <class X>
struct Wrench {
  Vec3<X> f, n;
};

// On one link: the sum of wrenches along its axes and along those of the world.
template <class X>
struct ExternalWrench {
  Vec3<X> point;        // m, in the link's frame; both act there
  Wrench<X> with_link;  // N, N m, in the link's frame
  Wrench<X> with_base;  // N, N m, in the base's frame

  // number(x) for everything that it is, in a fixed order.
  template <class Number>
  constexpr void for_each_number(Number&& number) {
    for (Vec3<X>* one : {&point, &with_link.f, &with_link.n, &with_base.f, &with_base.n})
      number(one->x), number(one->y), number(one->z);
  }

  // In the link's frame and about its origin; x and y: axes of the base in the link's frame.
  ARM_INLINE Wrench<X> at_origin(const Vec3<X>& base_x, const Vec3<X>& base_y) const {
    const Vec3<X> base_z = cross(base_x, base_y);
    const auto rotate = [&](const Vec3<X>& a) __attribute__((always_inline)) {
      return a.x * base_x + a.y * base_y + a.z * base_z;
    };
    const Vec3<X> f = with_link.f + rotate(with_base.f);
    return {f, with_link.n + rotate(with_base.n) + cross(point, f)};
  }
};

// As it is given (arm_wrench): point, force and moment, and whether their axes are the world's.
struct GivenWrench {
  Real numbers[10];
};

// A wrench on a link of a scene, with axes of the core instead of the URDF's.
template <class S>
ExternalWrench<Real> in_core_axes(int link, const GivenWrench& given) {
  ExternalWrench<Real> wrench = {};
  if constexpr (S::external_wrench) {
    using Axes = Real[3][3];
    const auto turned = [](const Axes& R, const Real* a) {
      const auto row = [a](const Real* r) { return r[0] * a[0] + r[1] * a[1] + r[2] * a[2]; };
      return Vec3<Real>{row(R[0]), row(R[1]), row(R[2])};
    };
    const Real *point = given.numbers, *f = point + 3, *n = f + 3;
    const bool of_world = n[3] != 0.0;
    const Axes& axes = of_world ? S::world_axes : S::link_axes[link];
    const Wrench<Real> w = {turned(axes, f), turned(axes, n)};
    (of_world ? wrench.with_base : wrench.with_link) = w;
    wrench.point = turned(S::link_axes[link], point);
  }
  return wrench;
}

// Wrenches on all links; empty in a scene without them.
template <class S, class X>
struct ExternalWrenches {
  static constexpr bool present = S::external_wrench;
  ExternalWrench<X> on[present ? S::L : 1] = {};
};

}  // namespace arm
