/* What an importer of FMI 3.0 does each servo period, and the same by arm.h, for bench/fmu.py. */
#include "arm.h"
#include "fmi3.h"

typedef fmi3Status set_values(fmi3Instance, const fmi3ValueReference[], size_t, const double[],
                              size_t);
typedef fmi3Status get_counts(fmi3Instance, const fmi3ValueReference[], size_t, int64_t[], size_t);
typedef fmi3Status do_step(fmi3Instance, double, double, bool, bool*, bool*, bool*, double*);
typedef int exchange_all(arm_machine*, const arm_command*, arm_measurement*);

/* `steps` steps of `periods` servo periods from `time` on; the time of the end, or -1. */
__attribute__((visibility("default"))) double run_fmi(set_values* set, do_step* step,
                                                      get_counts* get, fmi3Instance instance,
                                                      double time, double period, int64_t periods,
                                                      int64_t steps, uint32_t command,
                                                      const double* values, uint32_t encoder,
                                                      int64_t* counts, size_t joints) {
  bool flags[3];
  for (int64_t k = 0; k < steps; ++k) {
    if (set(instance, &command, 1, values, joints) ||
        step(instance, time, (double)periods * period, true, flags, flags + 1, flags + 2, &time) ||
        get(instance, &encoder, 1, counts, joints))
      return -1.0;
  }
  return time;
}

__attribute__((visibility("default"))) int run_arm(exchange_all* exchange, arm_machine* machine,
                                                   const arm_command* command, arm_measurement* out,
                                                   int64_t periods) {
  int result = ARM_OK;
  for (int64_t k = 0; k < periods && result == ARM_OK; ++k)
    result = exchange(machine, command, out);
  return result;
}
