/* Some numbers of a machine behind arm.h, kept at the end of every exchange. C99. */
#ifndef SAMPLER_H
#define SAMPLER_H

#include "arm.h"

#ifdef __cplusplus
extern "C" {
#endif

enum sampler_kind { SAMPLER_DOUBLE, SAMPLER_INT64, SAMPLER_UINT32 };

/* Where a number lies among what the core writes. */
typedef struct sampler_number {
  int64_t offset; /* bytes */
  int32_t kind;
  int32_t row; /* of the samples */
} sampler_number;

typedef struct sampler {
  uint32_t size;
  int32_t count;                                        /* of numbers */
  int (*measure)(const arm_machine*, arm_measurement*); /* null: nothing of it is asked for */
  int (*get_truth)(const arm_machine*, arm_truth*);
  arm_measurement* measurement; /* these write into `row` */
  arm_truth* truth;
  const char* row;
  const sampler_number* numbers;
  double* samples; /* rows of `room` */
  int64_t room;
  int64_t taken; /* what finds no room is not kept */
} sampler;

/* Keep a sample; a listener of arm_listen, `with` being the sampler. */
void sampler_take(void* with, const arm_machine* machine);

#ifdef __cplusplus
}
#endif

#endif
