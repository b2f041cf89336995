// Friction at the link: viscous, part of eq. (4), and Coulomb's (coulomb.hpp).
#pragma once

namespace arm {

struct LinkFriction {
  double Dl = 0.0;            // N m s/rad, viscous
  double Dc = 0.0, Ds = 0.0;  // N m, while the joint slides, and what holds it at rest
};

}  // namespace arm
