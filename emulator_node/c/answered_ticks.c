#include "answered_ticks.h"

#include <string.h>

/* Whether these are commands of the known form that answer this tick, and can be taken. */
static int answers(answered_ticks* ticks, const uint8_t* data, int64_t size) {
  if (ticks->tick >= ticks->last || ticks->result != ARM_OK) return 0;
  if (!ros_fits(&ticks->pattern, data, size)) return 0;
  int64_t tick;
  uint64_t emulator;
  memcpy(&tick, data + ticks->tick_at, sizeof tick);
  memcpy(&emulator, data + ticks->machine_at, sizeof emulator);
  if (tick != ticks->tick || (emulator && emulator != ticks->emulator)) return 0;
  return ros_doubles(data + ticks->command_at, ticks->joints, ticks->place, ticks->most,
                     ticks->came);
}

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
  if (!answers(ticks, data, size)) return ROS_FOR_PYTHON;
  for (int32_t j = 0; j < ticks->joints; ++j) {
    ticks->before[j] = ticks->joint[j].value;
    ticks->joint[j].value = ticks->came[j];
  }
  ros_log_put(ticks->log, ticks->number, data, size);
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
