/* Expensive parts of planning a way: the joints along a way of the tool, their torques,
 * and the timing of least duration within limits. No state, no allocation by the caller's leave:
 * all arrays are the caller's, row by row. Apache-2.0. */
#ifndef ARM_WAY_H
#define ARM_WAY_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* A chain or tree of joints with one degree of freedom each, parents before children. */
typedef struct {
  int32_t joints;
  int32_t coordinates;      /* that are commanded: the joints are coupling * coordinates + offset */
  int32_t tool_coordinates; /* of those: that move the tool */
  const int32_t* parent;    /* (joints), -1: the world */
  const int32_t* slides;    /* (joints), 1: along its axis; 0: it turns about it */
  const double* axis;       /* (joints, 3) in the joint's frame */
  const double* rotation;   /* (joints, 3, 3) of the joint's frame in its parent's, at 0 */
  const double* place;      /* (joints, 3) of it [m] */
  const double* coupling;   /* (joints, coordinates) */
  const double* offset;     /* (joints) */
  const double* scale;      /* (coordinates) of a step: 1, the reach [m], or less */
  const double* mass;       /* (joints) of the bodies [kg] */
  const double* centre;     /* (joints, 3) of their masses, in the joints' frames [m] */
  const double* inertia;    /* (joints, 3, 3) about it, along the joints' axes [kg m2] */
  const double* gravity;    /* (3) in the world [m/s2] */
  int32_t tool_parent;      /* -1: the world */
  const double* tool_rotation; /* (3, 3) in its parent's frame */
  const double* tool_place;    /* (3) [m] */
  double reach;                /* [m], by which the tool's errors are divided */
} way_arm;

/* A curve of the coordinates over s in [0, 1]: polynomials piece by piece. */
typedef struct {
  int32_t pieces;
  int32_t degrees;            /* coefficients of a polynomial */
  int32_t columns;            /* coordinates */
  const double* breaks;       /* (pieces + 1), where pieces begin, and 1 */
  const double* coefficients; /* (pieces, degrees, columns), in powers of s - breaks */
} way_curve;

/* Limits along a way. */
typedef struct {
  const double* speed; /* (columns) of the coordinates, as those below */
  const double* acceleration;
  const double* jerk;
  const double* torque;     /* infinite: none */
  double asked;             /* s, time that no part of the way falls below in proportion; 0: none */
  double length;            /* m, of the tool's curve; 0: the tool is not limited */
  double tool_speed;        /* m/s */
  double tool_acceleration; /* m/s2, along and across */
  double tool_jerk;         /* m/s3 */
  int32_t parts;            /* of the tool's curve */
  const double* ends;       /* (parts) in s */
  const double* curvature;  /* (parts) 1/m */
} way_limits;

/* Tool poses p (count, 3), R (count, 3, 3) of joint coordinates q (count, joints). */
void way_forward(const way_arm* arm, int32_t count, const double* q, double* p, double* R);

/* Torques tau (count, joints) at q, v, a (count, joints) each. */
void way_torques(const way_arm* arm, int32_t count, const double* q, const double* v,
                 const double* a, double* tau);

/* Coordinates q (count + 1, coordinates) that take the tool from row 0, where it is, through poses
 * p, R (count, ...): the nearest ones to the line of the joints to `goal` (coordinates), or, where
 * that is NULL, to the way before. rows: 3, position only; 6. Returns how many poses were reached.
 */
int32_t way_trace(const way_arm* arm, int32_t rows, int32_t count, const double* p, const double* R,
                  const double* goal, double* q);

/* Second derivatives m (nodes, columns) of the cubic spline through y (nodes, columns), `step`
 * apart; at both ends those of the cubic through the four nodes there. work: (nodes). */
void way_spline(int32_t nodes, int32_t columns, double step, const double* y, double* m,
                double* work);

/* Timing of least duration: c = (ds/dt)^2 over s in [0, 1], a quadratic spline of `intervals` equal
 * pieces, of which `coefficients` (intervals + 2) are found. At three points of each piece, its
 * begin, middle and end, (points = 3 intervals):
 *
 *   c <= most,
 *   |firsts_0 + firsts_c c + firsts_d dc/ds| <= 1      (points, firsts) each,
 *   |thirds_c c + thirds_d dc/ds + thirds_e d2c/ds2| sqrt(c) <= 1   (points, thirds) each.
 *
 * gap: how much longer than the shortest it may be, in parts of it. work: of way_work numbers.
 * Returns -1, or the point at which not even rest keeps the limits. */
/* The rows of way_time at places sigma (count) of a curve whose s over sigma has ramps
 * (timed_path.py): most (count), firsts (3, count, F) and thirds (3, count, G). F is the number of
 * coordinates, of limited torques unless arm is NULL, and 1 where the tool is limited; G the same
 * without torques. */
void way_rows(const way_arm* arm, const way_curve* curve, const way_limits* limits, double ramp,
              int32_t count, const double* sigma, double* most, double* firsts, double* thirds);

/* Factors of c, 1 or less, with which the timing keeps all limits at `looks` evenly spread places
 * of each piece, both ends among them, `keeps` (intervals). jerk_margin: factor of jerks. */
void way_keeps(const way_arm* arm, const way_curve* curve, const way_limits* limits, double ramp,
               int32_t intervals, const double* coefficients, int32_t looks, double jerk_margin,
               double* keeps);

int64_t way_work(int32_t intervals, int32_t firsts, int32_t thirds);
int32_t way_time(int32_t intervals, const double* most, int32_t firsts, const double* firsts_0,
                 const double* firsts_c, const double* firsts_d, int32_t thirds,
                 const double* thirds_c, const double* thirds_d, const double* thirds_e, double gap,
                 double* work, double* coefficients);

#ifdef __cplusplus
}
#endif
#endif
