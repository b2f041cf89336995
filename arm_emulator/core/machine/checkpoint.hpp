// The whole state of a machine at an instant, as it is kept and saved.
#pragma once

#include <cstdint>

#include "machine/brakes.hpp"
#include "mechanics/energy.hpp"
#include "mechanics/links/external_work.hpp"
#include "mechanics/state.hpp"

namespace arm {

template <class S, class Memory, int row>
struct Checkpoint {
  State<S> x;
  Memory memory;
  EnergyBalance<S> balance;
  ExternalWork<S> work;
  Real u[row];  // the commands of the step before, within the supply
  Real power;   // W, that the motors are given at most
  std::int64_t steps_taken;

  // number(x) for all of its numbers, in a fixed order.
  template <class Number>
  void for_each_number(Number&& number) {
    arm::for_each_number(x, number);
    memory.for_each_number(number);
    balance.for_each_number(number);
    work.for_each_number(number);
    for (int j = 0; j < S::N; ++j) number(u[j]);
    number(power);
    number(steps_taken);
  }
};

// With the state to which it returns if the energy check fails.
template <class S, class Checkpoint>
struct FullState {
  Checkpoint now, checked;
  std::int64_t fault;
  Brakes<S> brakes;

  template <class Number>
  void for_each_number(Number&& number) {
    now.for_each_number(number);
    checked.for_each_number(number);
    number(fault);
    brakes.for_each_number(number);
  }
};

}  // namespace arm
