// A link's frame in its parent's, and what goes through it: vectors, tensors, bodies.
#pragma once

#include "mechanics/links/tree.hpp"

namespace arm {

// A link's frame in its parent's, at one q. Vectors go up and down the tree through it.
template <class X>
struct Placement {
  X sin, cos;                 // of the turn about z
  Real cos_alpha, sin_alpha;  // of the fixed turn about x
  Vec3<X> p;                  // origin, in the parent's frame

  ARM_INLINE static constexpr Placement make(const Link& link, const X& sin, const X& cos,
                                             const Vec3<X>& p) {
    return {sin, cos, link.cos_alpha, link.sin_alpha, p};
  }
  // The link's z in its parent's frame.
  ARM_INLINE static constexpr Vec3<Real> axis(const Link& link) {
    return {0.0, -link.sin_alpha, link.cos_alpha};
  }

  ARM_INLINE constexpr Vec3<X> to_child(const Vec3<X>& u) const {
    const X y = cos_alpha * u.y + sin_alpha * u.z;
    return {sparse_fma(cos, u.x, sin * y), sparse_fma(cos, y, -(sin * u.x)),
            cos_alpha * u.z - sin_alpha * u.y};
  }
  ARM_INLINE constexpr Vec3<X> to_parent(const Vec3<X>& u) const {
    const X y = sparse_fma(sin, u.x, cos * u.y);
    return {sparse_fma(cos, u.x, -(sin * u.y)), cos_alpha * y - sin_alpha * u.z,
            sin_alpha * y + cos_alpha * u.z};
  }
  // A vector in the axes of the parent, plus `c` in them.
  ARM_INLINE constexpr Vec3<X> to_parent(const Vec3<X>& u, const Vec3<X>& c) const {
    const X y = sparse_fma(sin, u.x, cos * u.y);
    return {sparse_fma(cos, u.x, sparse_fma(-sin, u.y, c.x)),
            (cos_alpha * y - sin_alpha * u.z) + c.y, (sin_alpha * y + cos_alpha * u.z) + c.z};
  }
  // The tensor R a R^T of the parent's frame.
  ARM_INLINE constexpr Sym3<X> to_parent(const Sym3<X>& a) const {
    const X cc = cos * cos, ss = sin * sin, cs = cos * sin, twice = 2.0 * cs * a.xy;
    const X xx = sparse_fma(cc, a.xx, sparse_fma(ss, a.yy, -twice));
    const X yy = sparse_fma(ss, a.xx, sparse_fma(cc, a.yy, twice));
    const X xy = sparse_fma(cs, a.xx - a.yy, (cc - ss) * a.xy);
    const X xz = sparse_fma(cos, a.xz, -(sin * a.yz));
    const X yz = sparse_fma(sin, a.xz, cos * a.yz);
    const Real ca = cos_alpha, sa = sin_alpha;
    return {xx,
            ca * ca * yy + (sa * sa * a.zz - 2.0 * ca * sa * yz),
            sa * sa * yy + (ca * ca * a.zz + 2.0 * ca * sa * yz),
            ca * xy - sa * xz,
            sa * xy + ca * xz,
            ca * sa * (yy - a.zz) + (ca * ca - sa * sa) * yz};
  }
};

// A placement with a turn by gamma about the parent's z before it.
template <class X>
struct TurnedPlacement {
  Placement<X> turned;  // in the parent's frame, turned
  Real cos_gamma, sin_gamma;
  Vec3<X> p;  // origin, in the parent's frame

  ARM_INLINE static constexpr TurnedPlacement make(const Link& link, const X& sin, const X& cos,
                                                   const Vec3<X>& p) {
    return {Placement<X>::make(link, sin, cos, {}), link.cos_gamma, link.sin_gamma, p};
  }
  ARM_INLINE static constexpr Vec3<Real> axis(const Link& link) {
    return {link.sin_gamma * link.sin_alpha, -link.cos_gamma * link.sin_alpha, link.cos_alpha};
  }

  ARM_INLINE constexpr Vec3<X> to_child(const Vec3<X>& u) const {
    return turned.to_child(
        {cos_gamma * u.x + sin_gamma * u.y, cos_gamma * u.y - sin_gamma * u.x, u.z});
  }
  ARM_INLINE constexpr Vec3<X> to_parent(const Vec3<X>& u) const {
    const Vec3<X> w = turned.to_parent(u);
    return {cos_gamma * w.x - sin_gamma * w.y, sin_gamma * w.x + cos_gamma * w.y, w.z};
  }
  ARM_INLINE constexpr Vec3<X> to_parent(const Vec3<X>& u, const Vec3<X>& c) const {
    return to_parent(u) + c;
  }
  ARM_INLINE constexpr Sym3<X> to_parent(const Sym3<X>& a) const {
    const Sym3<X> t = turned.to_parent(a);
    const Real c = cos_gamma, s = sin_gamma;
    return {c * c * t.xx + s * s * t.yy - 2.0 * c * s * t.xy,
            s * s * t.xx + c * c * t.yy + 2.0 * c * s * t.xy,
            t.zz,
            c * s * (t.xx - t.yy) + (c * c - s * s) * t.xy,
            c * t.xz - s * t.yz,
            s * t.xz + c * t.yz};
  }
};

// A placement whose turn at 0 is any rotation.
template <class X>
struct FreePlacement {
  Axes<X> axes;  // of the link, in the parent's
  Vec3<X> p;     // origin, in the parent's frame

  template <class N>
  ARM_INLINE static constexpr FreePlacement make(const LinkPlace<N>& link, const X& sin,
                                                 const X& cos, const Vec3<X>& p) {
    const auto& [x, y, z] = link.axes;
    return {{cos * x + sin * y, cos * y - sin * x, Vec3<X>{} + z}, p};
  }
  template <class N>
  ARM_INLINE static constexpr const Vec3<N>& axis(const LinkPlace<N>& link) {
    return link.axes.z;
  }

  ARM_INLINE constexpr Vec3<X> to_child(const Vec3<X>& u) const { return axes.apply_transposed(u); }
  ARM_INLINE constexpr Vec3<X> to_parent(const Vec3<X>& u) const { return axes.apply(u); }
  ARM_INLINE constexpr Vec3<X> to_parent(const Vec3<X>& u, const Vec3<X>& c) const {
    return axes.apply(u) + c;
  }
  ARM_INLINE constexpr Sym3<X> to_parent(const Sym3<X>& a) const {
    const Vec3<X> x = {axes.x.x, axes.y.x, axes.z.x}, y = {axes.x.y, axes.y.y, axes.z.y},
                  z = {axes.x.z, axes.y.z, axes.z.z};
    const Vec3<X> ax = a * x, ay = a * y, az = a * z;
    return {dot(x, ax), dot(y, ay), dot(z, az), dot(x, ay), dot(x, az), dot(y, az)};
  }
};

template <class S, class X>
using PlacementIn =
    std::conditional_t<kPlacesVary<S>, FreePlacement<X>,
                       std::conditional_t<kTree<S>.forks, TurnedPlacement<X>, Placement<X>>>;

template <class X, class B>
ARM_INLINE constexpr Body<X> convert_body(const Body<B>& body) {
  return {X{} + body.m, Vec3<X>{} + body.h, Sym3<X>{} + body.I};
}

// A body with its child's fixed to it: the parallel-axis theorem with first moments, h and I about
// the parent's origin.
template <class P, class Where, class X>
ARM_INLINE constexpr Body<X> join_bodies(const Body<P>& parent, const Where& link,
                                         const Body<X>& child) {
  const Vec3<X> h = link.to_parent(child.h);
  const Vec3<X> p = link.p;
  const Vec3<X> mp = child.m * p, all = h + mp, by = h + all;
  // (by p) 1 minus the products, of which those off the diagonal are symmetric.
  const X xx = by.x * p.x, yy = by.y * p.y, zz = by.z * p.z;
  const Sym3<X> shift = {yy + zz,
                         xx + zz,
                         xx + yy,
                         sparse_fma(-all.x, p.y, -h.y * p.x),
                         sparse_fma(-all.x, p.z, -h.z * p.x),
                         sparse_fma(-all.y, p.z, -h.z * p.y)};
  return {parent.m + child.m, parent.h + all, parent.I + link.to_parent(child.I) + shift};
}

}  // namespace arm
