/* Valid as C++, too: units of both include it. */
#include "tick.h"

#include <stddef.h>

int tick_measure(tick_machine* at) {
  return at ? at->measure(at->machine, at->measurement) : ARM_REFUSED;
}

int tick_exchange(tick_machine* at, const arm_command* command) {
  if (!at) return ARM_REFUSED;
  const int result = at->exchange(at->machine, command, at->measurement);
  if (result == ARM_OK) ++at->tick;
  return result;
}

int tick_stops(const tick_machine* at) {
  return at && at->stop && __atomic_load_n(at->stop, __ATOMIC_ACQUIRE);
}

int tick_run(tick_machine* at, const tick_controller* controller, int64_t periods) {
  if (!at || !controller) return ARM_REFUSED;
  int result = tick_measure(at);
  if (result != ARM_OK && controller->take) controller->take(controller->with, at, result);
  for (; result == ARM_OK && periods > 0; --periods) {
    const arm_command* command = controller->answer(controller->with, at);
    if (!command) break;
    result = tick_exchange(at, command);
    if (controller->take) controller->take(controller->with, at, result);
    if (tick_stops(at)) break;
  }
  return result;
}
