// Common parts of the kernels that let time go on. Included last in a scene's unit, for a card or
// for its stand-in on a processor.
#pragma once

#include <new>

#include "controlled_group.hpp"
#include "fleet_kernels.h"
#include "numerics/finite.hpp"

namespace {

// arm::is_finite, also of a vector of one number: servos of arms without lanes have these.
template <class X>
ARM_INLINE auto mark_finite(const X& x) {
  if constexpr (arm::kWidth<X> == 1 && requires { x[0]; }) {
    arm::Mask<X> finite = {};
    finite[0] = arm::is_finite(x[0]) ? -1 : 0;
    return finite;
  } else {
    return arm::is_finite(x);
  }
}

}  // namespace

#define SERVO_IS_FINITE mark_finite
#define SERVO_FLEET_LANES arm_fleet::lanes
#include "servo_group.hpp"
// Behind all that the kernels call.
#include "kernel.hpp"

namespace {

// The lowest arm of all that refuse is known, whichever thread is first.
void record_refusal(std::int32_t* refused, int arm) {
  std::int32_t lowest = __atomic_load_n(refused, __ATOMIC_RELAXED);
  while (arm < lowest && !__atomic_compare_exchange_n(refused, &lowest, arm, true, __ATOMIC_RELAXED,
                                                      __ATOMIC_RELAXED)) {
  }
}

// One period or row of a call for a group, or all of them from the first on.
struct Advance {
  Advance(const fleet_advance_call& of, std::int64_t thread, std::int64_t of_period)
      : call(of), fleet(*of.fleet), g(static_cast<int>(thread)), period(of_period) {
    control.step = call.step, control.with = call.with, control.joint = call.joint;
    control.step_rows = call.step || call.step_rows ? call.step_rows : servo_fleet_step;
  }
  // `taken`: see ControlledGroup.
  ControlledGroup make_controlled_group(std::int64_t taken = -1) const {
    return {fleet, g, control, call.measurement, call.way, period, taken};
  }
  // The commands of a row, and the positions after it.
  template <class Number>
  Number* find_row(Number* rows) const {
    return rows + (period * fleet.arms + std::int64_t{g} * arm_fleet::lanes) * arm_fleet::J;
  }

  const fleet_advance_call& call;
  arm_fleet& fleet;
  int g;
  std::int64_t period;
  arm_fleet_control control = {};
};

}  // namespace
