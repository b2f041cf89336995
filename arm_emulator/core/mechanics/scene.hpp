// Structure of a scene, for the core. The loader writes one `struct Scene` of these constants per
// scene, and the core is compiled over it: what is zero or absent here costs nothing at run time.
#pragma once

#include <tuple>

#include "mechanics/drive.hpp"
#include "numerics/vector3.hpp"

namespace arm {

// Data exchanged by two threads: see two_threads.hpp.
enum class Exchange { lag, predict };
// Instants at which modes of joints change: at the ends of steps, or within them
// (event_location.hpp).
enum class Events { step, located };
enum class JointKind { revolute, prismatic };

// Inertia of a link with everything fixed to it, in the link's frame and about its origin.
template <class X>
struct Body {
  X m{};      // kg
  Vec3<X> h;  // kg m, mass times centre of mass
  Sym3<X> I;  // kg m2
};

// number(...) of each of their numbers in turn, for bodies side by side.
ARM_INLINE constexpr void for_each_number_of(auto&& number, auto&... body) {
  number(body.m...);
  number(body.h.x...), number(body.h.y...), number(body.h.z...);
  number(body.I.xx...), number(body.I.yy...), number(body.I.zz...);
  number(body.I.xy...), number(body.I.xz...), number(body.I.yz...);
}

// A body that carries m times what 1 kg of load is.
constexpr Body<Real> add_load(Body<Real> bare, Real m, const Body<Real>& per_kg) {
  for_each_number_of([m](Real& sum, const Real& share) { sum = sum + m * share; }, bare, per_kg);
  return bare;
}

// A joint's place and the link that it moves. The link's frame has its origin on the joint axis and
// z along it. Its x makes the turn from the parent's frame Rx(alpha) Rz(q + theta_0). A parent's
// x suits the first of its children; for the others Rz(gamma) comes first (Khalil, Kleinfinger).
struct Link {
  JointKind kind;
  int parent;                 // -1: the base
  Real cos_gamma, sin_gamma;  // 1 and 0 of a first child
  Real cos_alpha, sin_alpha;
  Real theta_0;                   // rad
  Real cos_theta_0, sin_theta_0;  // of it
  Vec3<Real> p;                   // m, origin in the parent's frame (at q = 0 of a prismatic joint)
  Body<Real> body;
};

// Columns of a rotation.
template <class X>
struct Axes {
  Vec3<X> x, y, z;

  ARM_INLINE constexpr auto apply(const auto& u) const { return u.x * x + u.y * y + u.z * z; }
  ARM_INLINE constexpr auto apply_transposed(const auto& u) const {
    return Vec3<decltype(dot(x, u))>{dot(x, u), dot(y, u), dot(z, u)};
  }
};

// Where a link's frame stands in its parent's with its joint at 0.
template <class X>
struct LinkPlace {
  Axes<X> axes;
  Vec3<X> p;
};

// number(...) of each of their numbers in turn, for places side by side.
ARM_INLINE constexpr void for_each_number_of_place(auto&& number, auto&... place) {
  const auto vector = [&](auto&... v) { number(v.x...), number(v.y...), number(v.z...); };
  vector(place.axes.x...), vector(place.axes.y...), vector(place.axes.z...), vector(place.p...);
}

template <int L, class X = Real>
struct LinkPlaces {
  LinkPlace<X> at[L] = {};
};

// Sine and cosine of an angle [rad] of at most 1, by Horner's scheme of both series.
constexpr void small_sincos(Real angle, Real& sin, Real& cos) {
  sin = 1.0, cos = 1.0;
  for (int k = 17; k > 0; k -= 2) {
    sin = 1.0 - sin * angle * angle / ((k + 1) * (k + 2));
    cos = 1.0 - cos * angle * angle / (k * (k + 1));
  }
  sin *= angle;
}

// A field g as seen from a base that is turned by an angle [rad], at most 1, about a unit vector.
constexpr Vec3<Real> rotate_field(const Vec3<Real>& g, const Vec3<Real>& axis, Real angle) {
  Real sin = 0.0, cos = 0.0;
  small_sincos(angle, sin, cos);
  const Vec3<Real> across = cross(axis, g);
  return dot(axis, g) * axis + cos * (g + (-dot(axis, g)) * axis) + (-sin) * across;
}

// A link whose joint's frame is displaced, as seen from that of the description: by x y z [m] and
// by roll, pitch and yaw [rad] as in a URDF. `described`: that frame in the parent's; `own`: turns
// its vectors into the link's axes.
constexpr LinkPlace<Real> displace_link(const LinkPlace<Real>& described, const Axes<Real>& own,
                                        const Vec3<Real>& xyz, const Vec3<Real>& rpy) {
  Real sr = 0.0, cr = 0.0, sp = 0.0, cp = 0.0, sy = 0.0, cy = 0.0;
  small_sincos(rpy.x, sr, cr), small_sincos(rpy.y, sp, cp), small_sincos(rpy.z, sy, cy);
  const Axes<Real> turn = {{cy * cp, sy * cp, -sp},
                           {cy * sp * sr - sy * cr, sy * sp * sr + cy * cr, cp * sr},
                           {cy * sp * cr + sy * sr, sy * sp * cr - cy * sr, cp * cr}};
  const auto column = [&](Vec3<Real> axis) {
    return described.axes.apply(turn.apply(own.apply_transposed(axis)));
  };
  return {{column({1.0, 0.0, 0.0}), column({0.0, 1.0, 0.0}), column({0.0, 0.0, 1.0})},
          described.axes.apply(xyz) + described.p};
}

template <int L>
struct LinkRow {
  Link at[L];
};

// A number that a scene lists as varied, and its bounds. Its value is no part of the scene's
// library: every machine brings its own.
struct Parameter {
  const char* name;
  Real least, most;
};

// Numbers of each machine: the scene's varied ones, then whether its brakes are closed
// (brakes.hpp).
template <class S>
inline constexpr int kOwnNumbers = S::parameters + S::brakes;

// Values that decide the structure of a scene: none of them is zero, nor a number under a fault of
// that share.
template <class S>
struct SomeValues {
  Real p[kOwnNumbers<S> + 1] = {};
  constexpr SomeValues() {
    for (int k = 0; k < kOwnNumbers<S>; ++k) p[k] = 0.5;
  }
};
template <class S>
inline constexpr auto kDrives = S::drives(SomeValues<S>().p);
template <class S>
inline constexpr auto kLinks = S::links(SomeValues<S>().p);
// Whether joints' places are data of each machine.
template <class S>
inline constexpr bool kPlacesVary = requires(const Real* p) { S::places(p); };

// Whether joints go with several drives or a drive with several joints (links.hpp).
template <class S>
inline constexpr bool kCoupled = requires { S::coupling; };

// Kind of the joint after which the shaft of drive j is named.
template <class S>
constexpr JointKind joint_kind(int j) {
  if constexpr (kCoupled<S>)
    return kLinks<S>.at[S::link_of[j]].kind;
  else
    return kLinks<S>.at[j].kind;
}

// Joints that controllers know. Where bearings give way, further ones of the machine stand behind
// each of them: their deflections, with drives without motors (parts/bearing.hpp).
template <class S>
inline constexpr bool kDeflects = requires { S::drive_of; };
template <class S>
constexpr int count_joints() {
  if constexpr (kDeflects<S>)
    return S::J;
  else
    return S::N;
}
// The drive of such a joint.
template <class S>
constexpr int drive_of(int joint) {
  if constexpr (kDeflects<S>)
    return S::drive_of[joint];
  else
    return joint;
}
// The joint of a drive, or in whose bearing it is a deflection; -1 of -1.
template <class S>
constexpr int find_joint(int drive) {
  int joint = drive < 0 ? drive : count_joints<S>() - 1;
  while (joint >= 0 && drive_of<S>(joint) > drive) --joint;
  return joint;
}
// A row of such joints as one of drives, 0 for all others.
template <class S, class X>
struct DriveRow {
  X of[S::N] = {};
  explicit constexpr DriveRow(const X* row) {
    for (int j = 0; j < count_joints<S>(); ++j) of[drive_of<S>(j)] = row[j];
  }
};
// The number of rows of readings that are deflections.
template <class S>
constexpr int count_deflections() {
  if constexpr (kDeflects<S>)
    return S::deflections;
  else
    return 0;
}

// body(drive, j) for the drive of every joint of a scene, to learn its structure; its numbers are
// in numbers.hpp.
template <class S, class Body>
constexpr void for_each_drive(Body&& body) {
  [&]<int... j>(std::integer_sequence<int, j...>) {
    (body(std::get<j>(kDrives<S>), j), ...);
  }(std::make_integer_sequence<int, S::N>{});
}

// The states that a joint's drive has at most: the arrays of all drives have as many rows.
template <class S>
constexpr int max_states() {
  int maximum = 0;
  for_each_drive<S>(
      [&](const auto& drive, int) { maximum = maximum < drive.states ? drive.states : maximum; });
  return maximum;
}

// The parts with modes that a joint's drive has at most.
template <class S>
constexpr int max_modes() {
  int maximum = 0;
  for_each_drive<S>(
      [&](const auto& drive, int) { maximum = maximum < drive.modes ? drive.modes : maximum; });
  return maximum;
}

// Whether a property holds for the drive of any joint.
template <class S, class Property>
constexpr bool any_drive(Property&& property) {
  bool result = false;
  for_each_drive<S>([&](const auto& drive, int) { result = result || property(drive); });
  return result;
}

}  // namespace arm
