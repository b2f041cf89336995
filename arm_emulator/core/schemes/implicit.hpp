// Implicit Euler: first order, its error on the side of damping.
#pragma once

#include "schemes/linearly_implicit.hpp"

namespace arm {

struct Implicit : AnyScheme {
  static constexpr int stages = 1;
  template <class S, class X>
  using Method = LinearlyImplicit<S, X>;
};

}  // namespace arm
