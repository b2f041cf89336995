#include "answered_ticks.h"

static void report(answered_ticks* ticks) {
  const int64_t tick = ticks->tick, time = tick * ticks->period;
  ticks->publish(ticks->motor_state, time, tick, ticks->log);
  if (tick % ticks->report_ticks) return;
  ticks->get_truth(ticks->machine, ticks->truth);
  ticks->publish(ticks->joint_state, time, tick, ticks->log);
  ticks->publish(ticks->clock, time, tick, ticks->log);
}

int answered_ticks_take(void* with, const uint8_t* data, int64_t size) {
  answered_ticks* ticks = with;
  motor_commands* commands = &ticks->commands;
  if (ticks->tick >= ticks->last || ticks->result != ARM_OK) return ROS_FOR_PYTHON;
  if (motor_commands_read(commands, data, size) != ticks->tick) return ROS_FOR_PYTHON;
  for (int32_t j = 0; j < ticks->joints; ++j) {
    ticks->before[j] = ticks->joint[j].value;
    ticks->joint[j].value = commands->came[j];
  }
  ros_log_put(ticks->log, commands->number, data, size);
  ticks->command->tick = ticks->tick;
  ticks->command->came = 0;
  ticks->result = ticks->exchange(ticks->machine, ticks->command, ticks->measurement);
  if (ticks->result == ARM_OK) {
    ++ticks->tick;
    if (ticks->stop && *ticks->stop) ticks->last = ticks->tick;
    report(ticks);
  }
  return ROS_TAKEN;
}
