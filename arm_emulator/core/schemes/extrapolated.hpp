// The Rosenbrock method ROS2 with the links evaluated once: second
// order where motions are smooth.
#pragma once

#include "schemes/linearly_implicit.hpp"

namespace arm {

struct Extrapolated : AnyScheme {
  static constexpr int stages = 2;
  static constexpr bool extrapolates = true;
  template <class S, class X>
  using Method = LinearlyImplicit<S, X>;
};

}  // namespace arm
