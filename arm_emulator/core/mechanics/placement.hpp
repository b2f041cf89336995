// A link's frame in its parent's, and what goes through it: vectors, tensors, bodies.
#pragma once

#include "mechanics/scene.hpp"

namespace arm {

// A link's frame in its parent's, at one q. Vectors go up and down the chain through it.
template <class X>
struct Placement {
  X sin, cos;                 // of the turn about z
  Real cos_alpha, sin_alpha;  // of the fixed turn about x
  Vec3<X> p;                  // origin, in the parent's frame

  ARM_INLINE constexpr Vec3<X> to_child(const Vec3<X>& u) const {
    const X y = cos_alpha * u.y + sin_alpha * u.z;
    return {cos * u.x + sin * y, cos * y - sin * u.x, cos_alpha * u.z - sin_alpha * u.y};
  }
  ARM_INLINE constexpr Vec3<X> to_parent(const Vec3<X>& u) const {
    const X y = sin * u.x + cos * u.y;
    return {cos * u.x - sin * u.y, cos_alpha * y - sin_alpha * u.z,
            sin_alpha * y + cos_alpha * u.z};
  }
  // The tensor R a R^T of the parent's frame.
  ARM_INLINE constexpr Sym3<X> to_parent(const Sym3<X>& a) const {
    const X cc = cos * cos, ss = sin * sin, cs = cos * sin;
    const X xx = cc * a.xx + ss * a.yy - 2.0 * cs * a.xy;
    const X yy = ss * a.xx + cc * a.yy + 2.0 * cs * a.xy;
    const X xy = cs * (a.xx - a.yy) + (cc - ss) * a.xy;
    const X xz = cos * a.xz - sin * a.yz;
    const X yz = sin * a.xz + cos * a.yz;
    const Real ca = cos_alpha, sa = sin_alpha;
    return {xx,
            ca * ca * yy + sa * sa * a.zz - 2.0 * ca * sa * yz,
            sa * sa * yy + ca * ca * a.zz + 2.0 * ca * sa * yz,
            ca * xy - sa * xz,
            sa * xy + ca * xz,
            ca * sa * (yy - a.zz) + (ca * ca - sa * sa) * yz};
  }
};

template <class X, class B>
ARM_INLINE constexpr Body<X> over(const Body<B>& body) {
  return {X{} + body.m, Vec3<X>{} + body.h, Sym3<X>{} + body.I};
}

// A body with its child's fixed to it: the parallel-axis theorem with first moments, h and I about
// the parent's origin.
template <class P, class X>
ARM_INLINE constexpr Body<X> joined(const Body<P>& parent, const Placement<X>& link,
                                    const Body<X>& child) {
  const Vec3<X> h = link.to_parent(child.h);
  const Vec3<X> p = link.p;
  const Vec3<X> mp = child.m * p;
  const X trace = 2.0 * dot(h, p) + dot(mp, p);
  const Sym3<X> shift = {trace - 2.0 * h.x * p.x - mp.x * p.x, trace - 2.0 * h.y * p.y - mp.y * p.y,
                         trace - 2.0 * h.z * p.z - mp.z * p.z, -h.x * p.y - h.y * p.x - mp.x * p.y,
                         -h.x * p.z - h.z * p.x - mp.x * p.z,  -h.y * p.z - h.z * p.y - mp.y * p.z};
  return {parent.m + child.m, parent.h + h + mp, parent.I + link.to_parent(child.I) + shift};
}

}  // namespace arm
