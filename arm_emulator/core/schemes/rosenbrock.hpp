// The Rosenbrock method ROS2: second order, the links evaluated twice a step.
#pragma once

#include "schemes/linearly_implicit.hpp"

namespace arm {

struct Rosenbrock : AnyScheme {
  static constexpr int stages = 2;
  template <class S, class X>
  using Method = LinearlyImplicit<S, X>;
};

}  // namespace arm
