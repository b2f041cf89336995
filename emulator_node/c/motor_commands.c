#include "motor_commands.h"

int64_t motor_commands_read(motor_commands* own, const uint8_t* data, int64_t size) {
  if (size > own->largest || !message_open(own->reader, data, size)) return -1;
  if (own->input_names->came || own->inputs->came) return -1;
  if (own->tick < 0 || (own->machine && own->machine != own->emulator)) return -1;
  return message_rows(own->reader) ? own->tick : -1;
}
