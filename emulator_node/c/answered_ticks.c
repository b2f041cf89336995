#include "answered_ticks.h"

static void report(answered_ticks* ticks) {
  const int64_t tick = ticks->at->tick, time = tick * ticks->at->period;
  ticks->publish(ticks->motor_state, time, tick, ticks->log);
  if (tick % ticks->report_ticks) return;
  ticks->at->get_truth(ticks->at->machine, ticks->truth);
  ticks->publish(ticks->joint_state, time, tick, ticks->log);
  ticks->publish(ticks->clock, time, tick, ticks->log);
}

int answered_ticks_receive(void* with, const uint8_t* data, int64_t size) {
  answered_ticks* ticks = with;
  tick_machine* at = ticks->at;
  motor_commands* commands = &ticks->commands;
  if (at->tick >= ticks->last || ticks->result != ARM_OK) return ROS_FOR_PYTHON;
  if (motor_commands_read(commands, data, size) != at->tick) return ROS_FOR_PYTHON;
  if (tick_answers_take(ticks->answers, at->tick, at->tick, commands->came) != ANSWER_NEW)
    return ROS_FOR_PYTHON;
  for (int32_t j = 0; j < at->joints; ++j) ticks->joint[j].value = commands->came[j];
  ros_log_put(ticks->log, commands->number, data, size);
  ticks->command->tick = at->tick;
  ticks->command->came = 0;
  ticks->result = tick_exchange(at, ticks->command);
  if (ticks->result == ARM_OK) {
    if (tick_stops(at)) ticks->last = at->tick;
    report(ticks);
  }
  return ROS_TAKEN;
}
