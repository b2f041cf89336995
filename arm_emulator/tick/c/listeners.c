#include "listeners.h"

#include <stddef.h>

int listeners_add(listeners* all, void (*call)(void* with, const arm_machine* machine),
                  void* with) {
  if (!all || !call || all->count >= LISTENERS_MOST) return 0;
  const listener added = {call, with};
  all->each[all->count++] = added;
  return 1;
}

void listeners_remove(listeners* all, const void* with) {
  if (!all) return;
  int32_t count = 0;
  for (int32_t k = 0; k < all->count; ++k)
    if (all->each[k].with != with) all->each[count++] = all->each[k];
  all->count = count;
}

void listeners_call(void* with, const arm_machine* machine) {
  const listeners* all = with;
  for (int32_t k = 0; all && k < all->count; ++k) all->each[k].call(all->each[k].with, machine);
}
