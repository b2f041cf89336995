// What a scene tells the core. The loader writes one `struct Scene` of these constants per scene,
// and the core is compiled over it: what is zero or false here costs nothing at run time.
#pragma once

#include "vector3.hpp"

namespace arm {

enum class Scheme { paper, implicit, rosenbrock, extrapolated };
// What two threads exchange: see two_threads.hpp.
enum class Exchange { lag, predict };
enum class JointKind { revolute, prismatic };

// Armature circuit and rotor, eq. (1) and (2).
struct Motor {
  bool present;
  double R;              // ohm
  double L;              // H; 0: the current follows the voltage at once
  double Kt;             // N m/A
  double Kb;             // V s/rad
  double Mm;             // kg m2
  double current_limit;  // A; 0: none
};

// Gear between motor and link, eq. (2).
struct Gear {
  bool rigid;  // then Kg and Dg have no meaning, and the rotor is carried by the link
  double Ng;   // link turns per motor turn
  double Kg;   // N m/rad
  double Dg;   // N m s/rad
};

// Inertia of a link with everything fixed to it, in the link's frame and about its origin.
struct Body {
  double m;  // kg
  Vec3 h;    // kg m, mass times centre of mass
  Sym3 I;    // kg m2
};

// A joint and the link that it moves. The link's frame has its origin on the joint axis, z along
// it, and x so that the turn from the parent's frame is Rx(alpha) Rz(q + theta_0).
struct Joint {
  JointKind kind;
  double cos_alpha, sin_alpha;
  double theta_0;  // rad
  Vec3 p;          // m, origin in the parent's frame (at q = 0 of a prismatic joint)
  Body body;
  Motor motor;
  Gear gear;
  double Dl;      // N m s/rad, viscous friction at the link, eq. (4)
  double Dc, Ds;  // N m, Coulomb friction at the link while it slides, and before it starts to
};

}  // namespace arm
