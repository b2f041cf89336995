/* The loop of manutec_r3.hpp around the machine of tick.h. C99. */
#ifndef MANUTEC_R3_H
#define MANUTEC_R3_H

#include "tick.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct manutec_axis {
  double n;          /* motor turns per link turn */
  double w, D;       /* of the current regulator */
  double begin, way; /* rad, of the path */
  double x, C;       /* states at the beginning */
} manutec_axis;

typedef struct manutec_path {
  double rate, change; /* 1/s and 1/s2: speed and acceleration of s, that goes from 0 to 1 */
} manutec_path;

/* Go `periods` of `period` s. After each of them current, motor angle and speed, q and v, 6 of
 * each, go to `out`, which begins with those at the start. Returns ARM_OK, or how it ended. */
int manutec_run(tick_machine* at, const manutec_axis* axes, const manutec_path* path, double period,
                int64_t periods, double* out);

#ifdef __cplusplus
}
#endif

#endif
