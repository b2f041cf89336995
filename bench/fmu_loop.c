#include "fmu_loop.h"

#include <dlfcn.h>

#include "fmi3.h"
#include "tick.c"

static void* binary;

#define CALL(name) ((__typeof__(&name))dlsym(binary, #name))

void* begin_fmi(const char* file, const char* token) {
  binary = dlopen(file, RTLD_NOW);
  if (!binary) return NULL;
  fmi3Instance instance = CALL(fmi3InstantiateCoSimulation)("arm", token, NULL, false, false, false,
                                                            false, NULL, 0, NULL, NULL, NULL);
  if (!instance) return NULL;
  if (CALL(fmi3EnterInitializationMode)(instance, false, 0.0, 0.0, false, 0.0)) return NULL;
  return CALL(fmi3ExitInitializationMode)(instance) ? NULL : instance;
}

double run_fmi(void* instance, double time, double period, int64_t periods, int64_t steps,
               uint32_t command, const double* values, uint32_t encoder, int64_t* counts,
               int64_t joints) {
  __typeof__(&fmi3SetFloat64) set = CALL(fmi3SetFloat64);
  __typeof__(&fmi3DoStep) step = CALL(fmi3DoStep);
  __typeof__(&fmi3GetInt64) get = CALL(fmi3GetInt64);
  const size_t count = (size_t)joints;
  bool flags[3];
  for (int64_t k = 0; k < steps; ++k) {
    if (set(instance, &command, 1, values, count) ||
        step(instance, time, (double)periods * period, true, flags, flags + 1, flags + 2, &time) ||
        get(instance, &encoder, 1, counts, count))
      return -1.0;
  }
  return time;
}

void end_fmi(void* instance) { CALL(fmi3FreeInstance)(instance); }

static const arm_command* held(void* with, const tick_machine* at) {
  (void)at;
  return with;
}

int run_arm(tick_machine* at, const arm_command* command, int64_t periods) {
  const tick_controller controller = {(void*)command, held, NULL};
  return tick_run(at, &controller, periods);
}
