// Three-dimensional vectors and symmetric tensors, over any number type.
#pragma once

#include "numerics/loops.hpp"

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
  return a.x * b.x + a.y * b.y + a.z * b.z;
}
template <class A, class B>
ARM_INLINE constexpr auto cross(const Vec3<A>& a, const Vec3<B>& b) {
  return Vec3<decltype(a.x * b.x)>{a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z,
                                   a.x * b.y - a.y * b.x};
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
  return Vec3<decltype(a.xx * b.x)>{a.xx * b.x + a.xy * b.y + a.xz * b.z,
                                    a.xy * b.x + a.yy * b.y + a.yz * b.z,
                                    a.xz * b.x + a.yz * b.y + a.zz * b.z};
}

}  // namespace arm
