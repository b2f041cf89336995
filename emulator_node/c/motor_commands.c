#include "motor_commands.h"

#include <string.h>

int64_t motor_commands_read(motor_commands* own, const uint8_t* data, int64_t size) {
  if (!ros_fits(&own->pattern, data, size)) return -1;
  int64_t tick;
  uint64_t emulator;
  memcpy(&tick, data + own->tick_at, sizeof tick);
  memcpy(&emulator, data + own->machine_at, sizeof emulator);
  if (tick < 0 || (emulator && emulator != own->emulator)) return -1;
  const uint8_t* numbers = data + own->command_at;
  return ros_doubles(numbers, own->joints, own->place, own->most, own->came) ? tick : -1;
}
