#include "firmware_controller.h"

#include <stddef.h>

const arm_command* firmware_controller_answer(void* with, const tick_machine* at) {
  firmware_controller* code = with;
  if (!code || !at) return NULL;
  firmware_input in = {
      .size = sizeof in, .time = at->tick * at->period, .measured = at->measurement};
  firmware_output out = {sizeof out, 0, code->joint, code->further};
  for (; code->row + 1 < code->row_count && code->row_tick[code->row + 1] <= at->tick; ++code->row)
    in.new_row = 1;
  if (code->row >= 0) {
    in.q_target = code->rows + code->row * at->joints;
    in.new_targets = 1;
  }
  code->command->tick = code->tick = at->tick;
  code->command->came = 0;
  code->step(code->with, &in, &out);
  return code->stop && *code->stop ? NULL : code->command;
}

void firmware_controller_step(void* with, const firmware_input* in, firmware_output* out) {
  const firmware* code = with;
  if (code && code->step) code->step(in, out);
}
