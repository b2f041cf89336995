// Point of a machine: what its equations depend on, as the row of numbers between arm.h and
// equations.h: values of the varied numbers and the brakes, wrenches as given, state.
#pragma once

#include "mechanics/numbers.hpp"
#include "mechanics/state.hpp"

namespace arm {

template <class S>
struct EquationPoint {
  static constexpr int own = kOwnNumbers<S>, wrenches = S::external_wrench ? S::L : 0;
  static constexpr int of_wrench = sizeof(GivenWrench) / sizeof(Real);
  static constexpr int size = own + of_wrench * wrenches + (State<S>::K + 2) * S::N;

  Numbers<S> numbers;
  State<S> state;

  ARM_ONCE explicit EquationPoint(const Real* row) : numbers(row) {
    for (int k = S::parameters; k < own; ++k)
      if (row[k] != 0.0) numbers.set(k, row[k]);
    row += own;
    for (int link = 0; link < wrenches; ++link) {
      GivenWrench wrench;
      for (Real& number : wrench.numbers) number = *row++;
      numbers.set_external_wrench(link, in_core_axes<S>(link, wrench));
    }
    for_each_number(state, [&](Real& number) { number = *row++; });
  }
};

}  // namespace arm
