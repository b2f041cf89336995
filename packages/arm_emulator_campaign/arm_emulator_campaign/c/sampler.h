/* Some numbers of machines behind arm.h and arm_fleet.h, kept at the end of every servo period.
 * C99. */
#ifndef SAMPLER_H
#define SAMPLER_H

#include "arm_fleet.h"

#ifdef __cplusplus
extern "C" {
#endif

enum sampler_kind { SAMPLER_DOUBLE, SAMPLER_INT64, SAMPLER_UINT32 };

/* Where the core writes a number of the first machine, and how far that of the next one is. */
typedef struct sampler_number {
  const char* place;
  int64_t stride; /* bytes */
  int32_t kind;
  int32_t row; /* of the samples */
} sampler_number;

typedef struct sampler {
  uint32_t size;
  int32_t count; /* of numbers */
  int32_t rows;  /* of a machine's samples */
  int32_t reserved;
  /* Of one machine; `measure` null: nothing of it is asked for. */
  int (*measure)(const arm_machine*, arm_measurement*);
  int (*get_truth)(const arm_machine*, arm_truth*);
  arm_measurement* measurement;
  arm_truth* truth;
  /* Of the machines of a fleet: `arm_fleet_step`. */
  int (*show)(arm_fleet*, int32_t, int32_t, const arm_command*, int64_t, arm_fleet_measurement*,
              arm_fleet_truth*);
  arm_fleet* fleet;
  arm_fleet_measurement* measurements;
  arm_fleet_truth* truths;
  const sampler_number* numbers;
  double* samples; /* of each machine its rows of `room` */
  int64_t room;
  int64_t* taken; /* of each machine; what finds no room is not kept */
} sampler;

/* Keep a sample; a listener of arm_listen, `with` being the sampler. */
void sampler_record(void* with, const arm_machine* machine);
/* The same for machines of a fleet, as a look of arm_fleet_way. */
void sampler_record_group(void* with, int32_t first, int32_t arms);

#ifdef __cplusplus
}
#endif

#endif
