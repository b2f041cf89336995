// The links' inertia in base parameters (Khalil and Dombre, Modeling, Identification and Control of
// Robots, ch. 9): the part of a body that is symmetric about its own joint axis moves to the
// parent. The joint's motion does not depend on which of the two carries it.
//
// For a revolute joint that is the mass, the first moment along z, and a tensor diag(a, a, 0); with
// a = Iyy every link is left with m = 0, h_z = 0, Iyy = 0, and the compiler folds what they would
// multiply. A prismatic joint does not turn its link: the whole tensor moves. Inertia at the base
// does not move; of it only the potential energy remains.
#pragma once

#include "mechanics/links/placement.hpp"

namespace arm {

template <class S>
struct BaseParameters {
  static constexpr int L = S::L;
  Body<Real> body[L];
  Body<Real> fixed = {};  // with the base

  // `place`: of each link, where these vary.
  constexpr explicit BaseParameters(const Link (&link)[L],
                                    [[maybe_unused]] const LinkPlace<Real>* place = nullptr)
      : body() {
    for (int j = 0; j < L; ++j) body[j] = link[j].body;
    for (int j = L - 1; j >= 0; --j) {
      const bool is_revolute = link[j].kind == JointKind::revolute;
      Body<Real>& own = body[j];
      Body<Real> moving = {};
      if (is_revolute) {
        moving = {own.m, {0.0, 0.0, own.h.z}, {own.I.yy, own.I.yy, 0.0, 0.0, 0.0, 0.0}};
        own = {0.0,
               {own.h.x, own.h.y, 0.0},
               {own.I.xx - own.I.yy, 0.0, own.I.zz, own.I.xy, own.I.xz, own.I.yz}};
      } else {
        moving.I = own.I;
        own.I = {};
      }
      // The moved part is invariant under turns about z, the tensor alone under shifts along it.
      const auto at = [&] {
        using Placement = PlacementIn<S, Real>;
        if constexpr (kPlacesVary<S>) {
          return Placement::make(place[j], 0.0, 1.0, place[j].p);
        } else {
          const Real sin = is_revolute ? 0.0 : link[j].sin_theta_0,
                     cos = is_revolute ? 1.0 : link[j].cos_theta_0;
          return Placement::make(link[j], sin, cos, link[j].p);
        }
      }();
      Body<Real>& parent = link[j].parent < 0 ? fixed : body[link[j].parent];
      parent = join_bodies(parent, at, moving);
    }
  }
};

}  // namespace arm
