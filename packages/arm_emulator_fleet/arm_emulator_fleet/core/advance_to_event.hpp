// The kernel of the usual steps, which have no event. A module of its own on a card: a thread then
// needs little memory, since no code of events is in it.
#pragma once

#include "advance.hpp"

namespace {

// A period of a group up to its first event. Whether nothing is left of it.
bool advance_to_event(const Advance& advance) {
  const fleet_advance_call& call = advance.call;
  arm_fleet& fleet = advance.fleet;
  if (call.motion == FLEET_UNDER_ROWS)
    return fleet.follow_to_event(advance.g, advance.find_row(call.command), call.steps,
                                 advance.find_row(call.q));
  if (call.motion == FLEET_UNDER_HELD_COMMANDS)
    return fleet.hold_commands_to_event(advance.g, call.joint, call.tick);
  bool& has_refused = fleet.status[advance.g].has_refused;
  if (call.period == 0) has_refused = false;
  if (has_refused) return true;
  bool done = false;
  ControlledGroup controlled = advance.make_controlled_group();
  has_refused = !controlled.advance_to_event(done);
  if (has_refused) record_refusal(call.refused + 1, controlled.refused());
  return done || has_refused;
}

}  // namespace

// Groups of which something is left queue for `fleet_advance`, in any order.
ARM_KERNEL(fleet_advance_to_event) {
  if (*call.refused != FLEET_NONE_REFUSED) return;
  if (thread == 0) call.queue[1 - (call.period & 1)] = 0;  // of the next period
  if constexpr (arm_fleet::has_events_in_lanes) {
    const Advance advance(call, thread, call.period);
    arm_fleet::State state(advance.fleet, advance.g);
    const bool is_done = advance_to_event(advance);
    state.store();
    if (is_done) return;
  }
  std::int32_t* const count = call.queue + (call.period & 1);
  const std::int32_t place = __atomic_fetch_add(count, 1, __ATOMIC_RELAXED);
  call.queue[FLEET_QUEUE_BEGINS + place] = static_cast<std::int32_t>(thread);
}
