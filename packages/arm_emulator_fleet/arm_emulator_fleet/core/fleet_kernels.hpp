// The kernels of a fleet. Included last in a scene's unit, for a card or for its stand-in on a
// processor.
#pragma once

#include "advance.hpp"

namespace {

// act(machine, arm) for the arms of a group and of a mask, out of their lanes.
template <class Act>
void change_group_arms(arm_fleet* fleet, std::int64_t group, const std::uint8_t* mask, Act&& act) {
  const int g = static_cast<int>(group);
  const arm_fleet::State state(*fleet, g);
  for (int k = g * arm_fleet::lanes; k < fleet->end_of(g); ++k)
    if (!mask || mask[k]) fleet->move_to_machine(k), act(fleet->machine[k], k);
}

// Note the first arm of a group and of a mask that check(machine, arm) refuses.
template <class Check>
void check_group_arms(const arm_fleet* fleet, std::int64_t group, const std::uint8_t* mask,
                      std::int32_t* refused, Check&& check) {
  const int g = static_cast<int>(group);
  for (int k = g * arm_fleet::lanes; k < fleet->end_of(g); ++k)
    if ((!mask || mask[k]) && check(fleet->machine[k], k) != ARM_OK)
      return record_refusal(refused, k);
}

}  // namespace

ARM_KERNEL(fleet_measure_memory) {
  const std::int64_t groups = (call.count + arm_fleet::lanes - 1) / arm_fleet::lanes;
  call.bytes[0] = sizeof(arm_fleet);
  call.bytes[1] = call.count * (sizeof(arm_machine*) + sizeof(std::int32_t)) +
                  groups * (sizeof(arm_fleet::Group*) + sizeof(arm_fleet::GroupStatus)) +
                  arm_fleet::Rows::count_bytes(static_cast<int>(groups));
  call.bytes[2] = sizeof(arm_fleet::Group) + arm_fleet::lanes * sizeof(arm_machine);
  call.bytes[3] = sizeof(arm_fleet::Machine::Method);
  call.bytes[4] = arm_fleet::lanes;
  call.bytes[5] = arm::max_modes<Scene>() > 0 || arm::kLocatesEvents<Scene>;
  call.bytes[6] = arm_fleet::has_events_in_lanes;
}

ARM_KERNEL(fleet_begin) { new (call.fleet) arm_fleet(call.options, call.count); }
ARM_KERNEL(fleet_build) {
  call.fleet->build(static_cast<int>(thread), call.options);
  if (thread == 0) *call.saved_size = count_saved_bytes(*call.fleet->machine[0]);
}
ARM_KERNEL(fleet_end) { call.fleet->~arm_fleet(); }

ARM_KERNEL(fleet_check_start) {
  constexpr std::int64_t N = arm_fleet::J;
  check_group_arms(call.fleet, thread, call.mask, call.refused, [&](const arm_machine* arm, int k) {
    for (int j = 0; j < N; ++j) {
      const double q = call.q[k * N + j], v = call.v[k * N + j];
      if (!arm::is_finite(q) || arm::magnitude(q) > call.bounds[j])
        return arm->refuse(j, "q", "be finite, and not too far away", q);
      if (!arm::is_finite(v) || arm::magnitude(v) > call.bounds[N + j])
        return arm->refuse(j, "v", "be finite, and not too fast", v);
    }
    return int{ARM_OK};
  });
}
ARM_KERNEL(fleet_reset) {
  if (*call.refused != FLEET_NONE_REFUSED) return;
  constexpr std::int64_t N = arm_fleet::J;
  change_group_arms(call.fleet, thread, call.mask, [&](arm_machine* arm, int k) {
    arm_reset(arm, call.q + k * N, call.v + k * N);
  });
}

ARM_KERNEL(fleet_get_parameters) {
  const int g = static_cast<int>(thread);
  for (int k = g * arm_fleet::lanes; k < call.fleet->end_of(g); ++k)
    call.values[k] = call.fleet->machine[k]->machine.parameter(static_cast<int>(call.place));
}
ARM_KERNEL(fleet_check_parameters) {
  constexpr std::int64_t count = Scene::parameters;
  check_group_arms(call.fleet, thread, call.mask, call.refused, [&](const arm_machine* arm, int k) {
    for (int p = 0; p < count; ++p) {
      if (call.place >= 0 && p != call.place) continue;
      const double value = call.values[call.place < 0 ? k * count + p : k];
      if (!is_within_bounds(p, value))
        return arm->refuse(-1, "parameter", "be within its bounds", value);
    }
    return int{ARM_OK};
  });
}
ARM_KERNEL(fleet_set_parameters) {
  if (*call.refused != FLEET_NONE_REFUSED) return;
  constexpr std::int64_t count = Scene::parameters;
  change_group_arms(call.fleet, thread, call.mask, [&](arm_machine* arm, int k) {
    if (call.place < 0)
      arm->machine.set_parameters(call.values + k * count);
    else
      arm->machine.set_parameter(static_cast<int>(call.place), call.values[k]);
  });
}

ARM_KERNEL(fleet_set_wrench) {
  change_group_arms(call.fleet, thread, call.mask, [&](arm_machine* arm, int k) {
    arm_set_external_wrench(arm, static_cast<int>(call.link), call.wrench + k);
  });
}

ARM_KERNEL(fleet_power) {
  change_group_arms(call.fleet, thread, nullptr,
                    [&](arm_machine* arm, int k) { arm_power(arm, call.on[k] != 0); });
}

ARM_KERNEL(fleet_save) {
  change_group_arms(const_cast<arm_fleet*>(call.fleet), thread, nullptr,
                    [&](arm_machine* arm, int k) { write_saved(arm, call.saved + k * call.size); });
}
ARM_KERNEL(fleet_save_arm) {
  const int k = static_cast<int>(call.arm);
  const arm_fleet::State state(*call.fleet, k / arm_fleet::lanes);
  call.fleet->move_to_machine(k);
  write_saved(call.fleet->machine[call.arm], call.saved);
}
ARM_KERNEL(fleet_check_saved) {
  check_group_arms(call.fleet, thread, call.mask, call.refused, [&](const arm_machine* arm, int k) {
    return check_saved(arm, call.saved + k * call.stride, call.size);
  });
}
ARM_KERNEL(fleet_restore) {
  if (*call.refused != FLEET_NONE_REFUSED) return;
  change_group_arms(call.fleet, thread, call.mask, [&](arm_machine* arm, int k) {
    restore_saved(arm, call.saved + k * call.stride);
  });
}

ARM_KERNEL(fleet_get_refusal) { *call.why = call.fleet->machine[call.arm]->why; }

ARM_KERNEL(fleet_check_commands) {
  check_group_arms(call.fleet, thread, nullptr, call.refused, [&](const arm_machine* arm, int k) {
    return arm->check_commands(
        call.joint + std::int64_t{k} * arm_fleet::J,
        arm_fleet::row_of(call.further, std::int64_t{k} * Scene::inputs * arm_fleet::J));
  });
}
static void observe(const arm_fleet& fleet, int g, const arm_fleet_measurement& measurement,
                    const arm_fleet_truth& truth) {
  if (measurement.size || truth.size)
    fleet.observe(g, measurement.size ? &measurement : nullptr, truth.size ? &truth : nullptr);
}
ARM_KERNEL(fleet_observe) {
  if (call.refused && *call.refused != FLEET_NONE_REFUSED) return;
  const int g = static_cast<int>(thread);
  const arm_fleet::State state(*call.fleet, g);
  observe(*call.fleet, g, call.measurement, call.truth);
}

ARM_KERNEL(fleet_gather) {
  std::int64_t left = thread, at = 0;
  for (int axis = 2; axis >= 0; --axis) {
    at += left % call.shape[axis] * call.stride[axis];
    left /= call.shape[axis];
  }
  auto* to = static_cast<std::int64_t*>(call.to) + thread;
  *to = 0;
  __builtin_memcpy(to, call.given + at, call.size == 8 ? 8 : 4);
}

ARM_KERNEL(fleet_put_commands) {
  const int g = static_cast<int>(thread);
  const std::int64_t first = thread * arm_fleet::lanes * arm_fleet::J;
  for (std::int64_t k = first; k < std::int64_t{call.fleet->end_of(g)} * arm_fleet::J; ++k)
    call.joint[k].value = call.value[k];
}

ARM_KERNEL(fleet_check_changes) {
  const int g = static_cast<int>(thread), first = g * arm_fleet::lanes;
  if (const int arm =
          find_refused_change(*call.fleet, first, call.fleet->end_of(g) - first, call.way);
      arm >= 0)
    record_refusal(call.refused, arm);
}
// A group with all code: one that queues, the rest of its period; without a queue every group, all
// periods.
ARM_KERNEL(fleet_advance) {
  if (*call.refused != FLEET_NONE_REFUSED) return;
  const bool queues = call.queue;
  if (queues && thread >= call.queue[call.period & 1]) return;
  const std::int64_t group = queues ? call.queue[FLEET_QUEUE_BEGINS + thread] : thread;
  const Advance advance(call, group, queues ? call.period : 0);
  const std::int64_t periods = queues ? 1 : call.periods;
  arm_fleet& fleet = advance.fleet;
  const std::int64_t taken = queues ? fleet.status[advance.g].taken : -1;
  arm_fleet::State state(fleet, advance.g);
  if (call.motion == FLEET_UNDER_ROWS) {
    const std::int64_t stride = std::int64_t{fleet.arms} * arm_fleet::J;
    fleet.follow_rows(advance.g, advance.find_row(call.command), stride, periods, call.steps,
                      advance.find_row(call.q), taken < 0 ? 0 : taken);
  } else if (call.motion == FLEET_UNDER_CONTROL) {
    ControlledGroup controlled = advance.make_controlled_group(taken);
    if (!(queues ? controlled.finish_period() : controlled.advance(periods))) {
      fleet.status[advance.g].has_refused = true;
      record_refusal(call.refused + 1, controlled.refused());
    }
  } else if (periods > 0) {
    fleet.hold_commands(advance.g, call.joint, call.further, call.tick, periods, taken);
  }
  state.store();
}

ARM_KERNEL(fleet_look) {
  const int g = static_cast<int>(thread), first = g * arm_fleet::lanes;
  const arm_fleet::State state(*call.fleet, g);
  call.way.look(call.way.with, first, call.fleet->end_of(g) - first);
}

ARM_KERNEL(servos_measure_memory) {
  call.bytes[0] = sizeof(Group);
  call.bytes[1] = sizeof(Joint);
  call.bytes[2] = sizeof(servo_lanes);
}
ARM_KERNEL(servos_begin) {
  begin_servos(*call.servos, static_cast<int32_t>(thread), static_cast<int32_t>(call.arms));
}
// The arms of a group of servos, of so many.
template <class Act>
static void for_servos_of(std::int64_t group, std::int64_t arms, Act&& act) {
  for (std::int64_t k = group * L; k < (group + 1) * L && k < arms; ++k)
    act(static_cast<int32_t>(k));
}
ARM_KERNEL(servos_reset) {
  for_servos_of(thread, call.arms, [&](int32_t k) {
    if (call.mask[k]) reset_servo(*call.servos, k);
  });
}
ARM_KERNEL(servos_aim) {
  for_servos_of(thread, call.arms, [&](int32_t k) { update_targets(*call.servos, k); });
}
ARM_KERNEL(servos_retune) {
  retune_servo(*call.servos, static_cast<int32_t>(call.arm), call.joint);
}

#ifdef __CUDA__
// Most steps are then taken by the other module, and this one need not be the fastest.
extern "C" {
__attribute__((device)) int arm_is_assembled_quickly = arm_fleet::has_events_in_lanes;
}
#else
#include "advance_to_event.hpp"
#endif
