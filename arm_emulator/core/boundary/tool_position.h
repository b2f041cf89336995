/* The tool's position in the world for joint positions. C99. */
#ifndef TOOL_POSITION_H
#define TOOL_POSITION_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* A joint between base and tool, see core/mechanics: a turn about z, or a slide along it, then a
 * turn about x by alpha, about z by gamma, and p. */
typedef struct tool_joint {
  const double* share; /* of each drive in its position */
  double q_0;          /* of its position [rad or m] */
  double theta_0, cos_alpha, sin_alpha, cos_gamma, sin_gamma;
  double p[3]; /* m */
  int32_t slides;
  int32_t reserved;
} tool_joint;

typedef struct tool_chain {
  uint32_t size;
  int32_t joints;
  const tool_joint* joint; /* from the tool's to the first */
  int64_t drives;
  double p[3]; /* of the tool on the link of the first of `joint` [m] */
  double R[9]; /* from the base's axes to the world's, row by row */
} tool_chain;

/* Fill p (3, count) [m] for positions q of drives (drives, stride) [rad or m], at `count` instants.
 */
void tool_positions(const tool_chain* chain, const double* q, int64_t stride, int64_t count,
                    double* p);

#ifdef __cplusplus
}
#endif

#endif
