#include "answered_states.h"

#include <stddef.h>
#include <string.h>

/* Whether this is the state of the next tick, in the known form, within its bounds. */
static int is_next(answered_states* own, const uint8_t* data, int64_t size) {
  const motor_states* in = &own->in;
  if (!own->open || !ros_fits(&in->pattern, data, size)) return 0;
  int64_t tick;
  uint64_t machine;
  memcpy(&tick, data + in->tick_at, sizeof tick);
  memcpy(&machine, data + in->machine_at, sizeof machine);
  if (own->lockstep ? tick != own->tick + 1 : tick <= own->tick) return 0;
  if (machine && machine != own->machine) return 0;
  if (ros_time(data + in->stamp_at) != tick * own->period) return 0;
  const int64_t joints = own->arm->joints;
  const servo_bounds* most = &own->most;
  return ros_counts(data + in->counts_at, joints, in->place, most->counts, own->counts) &&
         ros_doubles(data + in->current_at, joints, in->place, most->current, own->current) &&
         (in->applied_at < 0 ||
          ros_doubles(data + in->applied_at, joints, in->place, most->applied, own->applied)) &&
         (in->brakes_at < 0 ||
          ros_counts(data + in->brakes_at, joints, in->place, most->brake, own->brake));
}

static void report(answered_states* own, int64_t time) {
  const servo* arm = own->arm;
  const int on = own->powered && arm->watchdog.does != SERVO_CUT;
  for (int32_t j = 0; j < arm->joints; ++j) {
    const servo_state* state = arm->state + j;
    own->movable[j] = on && !state->braked && !state->stood;
    own->q_measured[j] = state->theta_measured * arm->joint[j].ratio;
    own->v_measured[j] = state->omega * arm->joint[j].ratio;
    own->tau_measured[j] = state->load * arm->joint[j].motor_turns;
  }
  own->publish(own->servo_state, time, 0, NULL);
  own->publish(own->joint_state, time, 0, NULL);
}

/* Command and publish; Python goes on where the watchdog or a restart changes what is reported. */
static void answer(answered_states* own) {
  servo* arm = own->arm;
  const int32_t does = arm->does;
  const uint32_t restarts = arm->restarts;
  own->command(arm, (int32_t)own->powered, own->volts);
  ++own->answers;
  own->publish(own->motor_command, arm->now, own->tick, NULL);
  if (arm->does != does || arm->restarts != restarts) own->open = 0;
}

int answered_states_take(void* with, const uint8_t* data, int64_t size) {
  answered_states* own = with;
  const motor_states* in = &own->in;
  if (!is_next(own, data, size)) return ROS_FOR_PYTHON;
  memcpy(&own->tick, data + in->tick_at, sizeof own->tick);
  own->powered = data[in->powered_at] != 0;
  ++own->states;
  const int64_t time = own->tick * own->period;
  own->measure(own->arm, time, own->counts, own->current, in->applied_at < 0 ? NULL : own->applied);
  own->brakes(own->arm, in->brakes_at < 0 ? NULL : own->brake);
  const int begins = own->lockstep && own->motion_ticks && own->tick % own->motion_ticks == 0;
  if (begins) {
    own->waiting = 1;
    own->cycle = time;
  }
  if (begins || own->tick % own->report_ticks == 0) report(own, time);
  if (!own->waiting) answer(own);
  return ROS_TAKEN;
}

int answered_states_aim(void* with, const uint8_t* data, int64_t size) {
  answered_states* own = with;
  const joint_targets* in = &own->wanted;
  if (!own->open || !ros_fits(&in->pattern, data, size)) return ROS_FOR_PYTHON;
  const int64_t time = ros_time(data + in->stamp_at);
  const int in_turn = own->lockstep && own->motion_ticks;
  if (time < 0 || (in_turn && (!own->waiting || time != own->cycle))) return ROS_FOR_PYTHON;
  const int64_t joints = own->arm->joints;
  const servo_bounds* most = &own->most;
  if (!ros_doubles(data + in->q_at, joints, in->place, most->q, own->q) ||
      (in->v_at >= 0 && !ros_doubles(data + in->v_at, joints, in->place, most->v, own->v)) ||
      (in->tau_at >= 0 && !ros_doubles(data + in->tau_at, joints, in->place, most->tau, own->tau)))
    return ROS_FOR_PYTHON;
  own->aim(own->arm, own->q, in->v_at < 0 ? NULL : own->v, in->tau_at < 0 ? NULL : own->tau);
  if (own->waiting) {
    own->waiting = 0;
    answer(own);
  }
  return ROS_TAKEN;
}
