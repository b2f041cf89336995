#include "answered_states.h"

#include <stddef.h>
#include <string.h>

static int is_waiting_for_targets(const answered_states* own) {
  return own->lockstep && own->motion_ticks;
}

static void report(answered_states* own, int64_t time) {
  servo_report(own->arm, (int32_t)own->powered, own->q_measured, own->v_measured, own->tau_measured,
               own->movable);
  own->publish(own->servo_state, time, 0, NULL);
  own->publish(own->joint_state, time, 0, NULL);
}

static void publish_command(answered_states* own) {
  memcpy(own->motor_command->data + own->machine_at, &own->machine, sizeof own->machine);
  own->publish(own->motor_command, own->tick * own->period, own->tick, NULL);
}

/* Command and publish. Python continues where the watchdog or a restart changes the status. */
static void answer(answered_states* own) {
  servo* arm = own->arm;
  const int32_t does = arm->does;
  const uint32_t restarts = arm->restarts;
  servo_command(arm, (int32_t)own->powered, own->volts);
  ++own->answers;
  publish_command(own);
  if (arm->does != does || arm->restarts != restarts) own->open = 0;
}

/* ------------------------------------------------------------------------------ motor states */

int32_t answered_states_classify(answered_states* own, const uint8_t* data, int64_t size) {
  if (!message_open(own->state, data, size)) return STATE_MALFORMED;
  const int64_t time = own->state_time, tick = time / own->period;
  if (time % own->period || (uint64_t)tick != own->state_tick) return STATE_OFF_TIME;
  if (!message_rows(own->state)) return STATE_MALFORMED;
  const int is_first = own->tick < 0;
  if (own->state_machine && own->state_machine != own->machine) {
    const int is_later = own->machine && own->machine < own->state_machine;
    if (is_later && own->now - own->heard < own->longest_quiet) return STATE_OF_ANOTHER;
    return is_first ? STATE_NEXT : STATE_RESTARTED;
  }
  if (is_first) return STATE_NEXT;
  if (tick == own->tick) return STATE_REPEATED;
  /* In lock-step no tick is skipped, unless it runs free: then nothing is lost. */
  return tick < own->tick || (own->lockstep && tick > own->tick + 1) ? STATE_RESTARTED : STATE_NEXT;
}

void answered_states_accept(answered_states* own) {
  const int64_t time = own->state_time;
  if (own->state_machine) own->machine = own->state_machine;
  own->tick = (int64_t)own->state_tick;
  own->powered = own->state_powered;
  own->silent = 0;
  ++own->states;
  servo_measure(own->arm, time, own->counts, own->current,
                own->applied_field->came ? own->applied : NULL,
                own->brake_field->came ? own->brake : NULL);
  const int begins = is_waiting_for_targets(own) && own->tick % own->motion_ticks == 0;
  if (begins) {
    own->waiting = 1;
    own->cycle = time;
  }
  if (begins || own->tick % own->report_ticks == 0) report(own, time);
  if (!own->waiting) answer(own);
}

void answered_states_repeat(answered_states* own) {
  /* While it waits: as at the motion period's start, even if another servo has answered since. */
  if (own->waiting)
    report(own, own->cycle);
  else
    publish_command(own);
}

int answered_states_receive(void* with, const uint8_t* data, int64_t size) {
  answered_states* own = with;
  if (!own->open || answered_states_classify(own, data, size) != STATE_NEXT) return ROS_FOR_PYTHON;
  answered_states_accept(own);
  return ROS_TAKEN;
}

/* ----------------------------------------------------------------------------- joint targets */

static int has_same_target(const answered_states* own) {
  for (int32_t j = 0; j < own->arm->joints; ++j)
    if (own->q[j] != own->aimed[j]) return 0;
  return 1;
}

int32_t answered_states_classify_target(answered_states* own, const uint8_t* data, int64_t size) {
  if (!message_open(own->target, data, size) || !message_rows(own->target)) return TARGET_MALFORMED;
  const int64_t time = own->target_time;
  if (!is_waiting_for_targets(own)) return TARGET_DUE;
  if (time == own->cycle) return own->waiting ? TARGET_DUE : TARGET_DUPLICATE;
  /* A motion controller answers joint states once more that are repeated to it. */
  if (time == own->cycle - own->motion_ticks * own->period && has_same_target(own))
    return TARGET_REPEATED;
  return time == own->cycle_before_reset ? TARGET_BEFORE_RESET : TARGET_OFF_TIME;
}

void answered_states_set_target(answered_states* own) {
  memcpy(own->aimed, own->q, (size_t)own->arm->joints * sizeof *own->q);
  servo_aim(own->arm, own->q, own->v_field->came ? own->v : NULL,
            own->tau_field->came ? own->tau : NULL);
  if (!own->waiting) return;
  own->waiting = 0;
  answer(own);
}

int answered_states_receive_target(void* with, const uint8_t* data, int64_t size) {
  answered_states* own = with;
  if (!own->open || answered_states_classify_target(own, data, size) != TARGET_DUE)
    return ROS_FOR_PYTHON;
  answered_states_set_target(own);
  return ROS_TAKEN;
}
