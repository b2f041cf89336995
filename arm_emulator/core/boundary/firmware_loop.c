#include "firmware_loop.h"

#include <stddef.h>

static void aim(firmware_loop* loop, firmware_input* in) {
  if (!loop->row_count) return;
  while (loop->row + 1 < loop->row_count && loop->row_tick[loop->row + 1] <= loop->tick)
    ++loop->row;
  in->q_target = loop->rows + loop->row * loop->joints;
  in->new_targets = 1;
}

int firmware_loop_run(firmware_loop* loop, int64_t ticks) {
  if (!loop) return ARM_REFUSED;
  firmware_output out = {sizeof out, 0, loop->joint, loop->further};
  arm_command command = *loop->command;
  int result = loop->measure(loop->machine, loop->measurement);
  for (; result == ARM_OK && ticks > 0; --ticks) {
    firmware_input in = {sizeof in, 0,   loop->tick * loop->period, loop->measurement, NULL,
                         NULL,      NULL};
    aim(loop, &in);
    loop->step(loop->with, &in, &out);
    if (loop->stop && *loop->stop) break;
    command.tick = loop->tick;
    result = loop->exchange(loop->machine, &command, loop->measurement);
    if (result == ARM_OK) ++loop->tick;
  }
  return result;
}

void firmware_loop_step(void* with, const firmware_input* in, firmware_output* out) {
  const firmware* code = with;
  if (code && code->step) code->step(in, out);
}
