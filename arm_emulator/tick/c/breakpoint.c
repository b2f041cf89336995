#include "breakpoint.h"

void breakpoint_take(void* with, const arm_machine* machine) {
  breakpoint* one = with;
  if (!one || !one->what || !machine) return;
  const int holds = condition_holds(one->what, machine);
  if (holds && !one->held) {
    one->tick = one->what->measurement->tick;
    __atomic_store_n(&one->hit, 1, __ATOMIC_RELEASE);
  }
  one->held = holds;
}
