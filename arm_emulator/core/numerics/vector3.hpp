// Three-dimensional vectors and symmetric tensors, over any number type.
#pragma once

#include "numerics/fma.hpp"

namespace arm {

template <class X>
struct Vec3 {
  X x{}, y{}, z{};
};

template <class A, class B>
ARM_INLINE constexpr auto operator+(const Vec3<A>& a, const Vec3<B>& b) {
  return Vec3<decltype(a.x + b.x)>{a.x + b.x, a.y + b.y, a.z + b.z};
}
template <class A, class B>
ARM_INLINE constexpr auto operator-(const Vec3<A>& a, const Vec3<B>& b) {
  return Vec3<decltype(a.x - b.x)>{a.x - b.x, a.y - b.y, a.z - b.z};
}
template <class X>
ARM_INLINE constexpr Vec3<X> operator-(const Vec3<X>& a) {
  return {-a.x, -a.y, -a.z};
}
template <class K, class A>
ARM_INLINE constexpr auto operator*(const K& k, const Vec3<A>& a) {
  return Vec3<decltype(k * a.x)>{k * a.x, k * a.y, k * a.z};
}
template <class A, class B>
ARM_INLINE constexpr auto dot(const Vec3<A>& a, const Vec3<B>& b) {
  return sparse_fma(a.z, b.z, sparse_fma(a.y, b.y, a.x * b.x));
}
template <class A, class B>
ARM_INLINE constexpr auto cross(const Vec3<A>& a, const Vec3<B>& b) {
  return Vec3<decltype(a.x * b.x)>{sparse_fma(a.y, b.z, -(a.z * b.y)),
                                   sparse_fma(a.z, b.x, -(a.x * b.z)),
                                   sparse_fma(a.x, b.y, -(a.y * b.x))};
}
// The cross product a x b + c.
template <class A, class B, class C>
ARM_INLINE constexpr auto cross(const Vec3<A>& a, const Vec3<B>& b, const Vec3<C>& c) {
  return Vec3<decltype(a.x * b.x + c.x)>{sparse_fma(a.y, b.z, sparse_fma(-a.z, b.y, c.x)),
                                         sparse_fma(a.z, b.x, sparse_fma(-a.x, b.z, c.y)),
                                         sparse_fma(a.x, b.y, sparse_fma(-a.y, b.x, c.z))};
}
template <class K, class A, class C>
ARM_INLINE constexpr auto fma(const K& k, const Vec3<A>& a, const Vec3<C>& c) {
  return Vec3<decltype(k * a.x + c.x)>{sparse_fma(k, a.x, c.x), sparse_fma(k, a.y, c.y),
                                       sparse_fma(k, a.z, c.z)};
}

// Symmetric 3 x 3 tensor.
template <class X>
struct Sym3 {
  X xx{}, yy{}, zz{}, xy{}, xz{}, yz{};
};

template <class A, class B>
ARM_INLINE constexpr auto operator+(const Sym3<A>& a, const Sym3<B>& b) {
  return Sym3<decltype(a.xx + b.xx)>{a.xx + b.xx, a.yy + b.yy, a.zz + b.zz,
                                     a.xy + b.xy, a.xz + b.xz, a.yz + b.yz};
}
template <class A, class B>
ARM_INLINE constexpr auto operator*(const Sym3<A>& a, const Vec3<B>& b) {
  return Vec3<decltype(a.xx * b.x)>{dot(Vec3<A>{a.xx, a.xy, a.xz}, b),
                                    dot(Vec3<A>{a.xy, a.yy, a.yz}, b),
                                    dot(Vec3<A>{a.xz, a.yz, a.zz}, b)};
}

}  // namespace arm
