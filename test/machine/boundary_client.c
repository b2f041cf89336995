/* A user of arm.h who knows no Python: loads a scene's library, lets a machine run for some ticks,
 * goes back to a saved state and runs on. Prints tick, encoder counts and currents. C99. */
#include <dlfcn.h>
#include <stdio.h>
#include <stdlib.h>

#include "arm.h"

#define MOST_JOINTS 16
#define CALL(name) (*(void**)& name = dlsym(library, #name))

int main(int count, char** words) {
  int (*arm_describe)(arm_description*);
  int (*arm_describe_joint)(int32_t, arm_joint_description*);
  arm_machine* (*arm_new)(const arm_options*);
  void (*arm_delete)(arm_machine*);
  int (*arm_exchange)(arm_machine*, const arm_command*, arm_measurement*);
  int64_t (*arm_saved_size)(void);
  int (*arm_save)(const arm_machine*, void*, int64_t);
  int (*arm_restore)(arm_machine*, const void*, int64_t);
  void* library = count == 3 ? dlopen(words[1], RTLD_NOW) : NULL;
  if (!library) return 2;
  CALL(arm_describe), CALL(arm_describe_joint), CALL(arm_new), CALL(arm_delete), CALL(arm_exchange);
  CALL(arm_saved_size), CALL(arm_save), CALL(arm_restore);

  arm_description arm = {.size = sizeof arm};
  if (arm_describe(&arm) != ARM_OK || arm.joints > MOST_JOINTS) return 3;
  for (int j = 0; j < arm.joints; ++j) {
    arm_joint_description joint = {.size = sizeof joint};
    arm_describe_joint(j, &joint);
    printf("%s %.17g\n", joint.name, joint.counts_per_rad);
  }
  const arm_options options = {
      .size = sizeof options, .core = -1, .step = 1e-4, .steps_per_period = 10};
  arm_machine* machine = arm_new(&options);
  arm_joint_command commands[MOST_JOINTS];
  arm_joint_measurement measured[MOST_JOINTS];
  arm_command command = {.size = sizeof command, .joint = commands};
  arm_measurement measurement = {.size = sizeof measurement, .joint = measured};
  void* saved = malloc((size_t)arm_saved_size());
  const int ticks = atoi(words[2]);
  for (int turn = 0; turn < 2; ++turn) {
    for (int k = 0; k < ticks; ++k) {
      for (int j = 0; j < arm.joints; ++j)
        commands[j] = (arm_joint_command){ARM_VOLTAGE, 1, (j + 1) * (k % 7 - 3)};
      command.tick = measurement.tick;
      if (arm_exchange(machine, &command, &measurement) != ARM_OK) return 4;
      if (turn == 0 && k == ticks / 2) arm_save(machine, saved, arm_saved_size());
    }
    printf("%lld", (long long)measurement.tick);
    for (int j = 0; j < arm.joints; ++j)
      printf(" %lld %.17g", (long long)measured[j].encoder, measured[j].current);
    printf("\n");
    arm_restore(machine, saved, arm_saved_size());
  }
  arm_delete(machine);
  free(saved);
  return 0;
}
