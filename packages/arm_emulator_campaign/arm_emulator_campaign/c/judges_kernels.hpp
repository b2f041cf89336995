// The judges of runs that are on a device: a unit of its own, for campaigns of all scenes.
#pragma once

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "begin_kernels.hpp"
#include "kernel.hpp"

// Functions of the C library that the judges call and a card has not. Copies on a device never
// grow.
#undef isnan
#define isnan(x) __builtin_isnan(x)
#define fabs(x) __builtin_fabs(x)
#define sqrt(x) __builtin_sqrt(x)
#define memcpy(to, from, size) __builtin_memcpy(to, from, size)
#define memmove(to, from, size) __builtin_memmove(to, from, size)
#define calloc(count, size) nullptr
#define realloc(memory, size) nullptr
#define free(memory) static_cast<void>(memory)
#define restrict __restrict

#include "formula.c"
#include "judges.c"
#include "judges_kernels.h"
#include "robustness.c"

ARM_KERNEL(judge_build) {
  judges& own = call.all[thread];
  own = *call.like;
  own.values = call.values + thread * own.row_count * FORMULA_BLOCK;
  own.at = call.at + thread * own.row_count;
  own.measures = call.measures + thread * own.measure_count;
  for (std::int32_t k = 0; k < own.measure_count; ++k) own.measures[k] = call.like->measures[k];
  robustness** copies = call.copies + thread * own.requirement_count;
  own.requirements = copies;
  char* room = call.rooms + thread * call.room;
  for (std::int32_t k = 0; k < own.requirement_count; ++k) {
    copies[k] = robustness_copy(call.requirements[k], room);
    room += call.room_of[k];
  }
}

ARM_KERNEL(judge_begin) { begin_run(&call.all[thread]); }

ARM_KERNEL(judge_add_samples) {
  judges_samples piece = {};
  const std::int64_t target = call.first[thread];
  piece.count = call.counts[thread];
  piece.stride = call.stride;
  piece.rows = call.samples + thread * call.sample_rows * call.stride;
  piece.since = call.since + target;
  piece.targets = call.targets + target * call.joints;
  piece.target_count = call.first[thread + 1] - target;
  piece.joints = call.joints;
  if (add_samples_of_piece(&call.all[thread], &piece)) *call.failed = 1;
}

ARM_KERNEL(judge_end) {
  judges& own = call.all[thread];
  end_run(&own, call.robustness + thread * own.requirement_count,
          call.measures + thread * own.measure_count);
}

#include "end_kernels.hpp"
