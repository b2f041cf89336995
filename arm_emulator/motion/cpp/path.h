/* Expensive parts of planning a path: the joints along a path of the tool, their torques,
 * and the timing of least duration within limits. All arrays are the caller's, row by row, and
 * nothing is kept. Apache-2.0. */
#ifndef ARM_PATH_H
#define ARM_PATH_H

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
} path_arm;

/* A curve of the coordinates over s in [0, 1]: polynomials piece by piece. */
typedef struct {
  int32_t pieces;
  int32_t degrees;            /* coefficients of a polynomial */
  int32_t columns;            /* coordinates */
  const double* breaks;       /* (pieces + 1), where pieces begin, and 1 */
  const double* coefficients; /* (pieces, degrees, columns), in powers of s - breaks */
} path_curve;

/* Limits along a path. */
typedef struct {
  const double* speed; /* (columns) of the coordinates, as those below */
  const double* acceleration;
  const double* jerk;
  const double* torque; /* infinite: none */
  double requested;     /* s, time that no part of the path falls below in proportion; 0: none */
  double length;        /* m, of the tool's curve; 0: the tool is not limited */
  double tool_speed;    /* m/s */
  double tool_acceleration; /* m/s2, along and across */
  double tool_jerk;         /* m/s3 */
  int32_t parts;            /* of the tool's curve */
  const double* ends;       /* (parts) in s */
  const double* curvature;  /* (parts) 1/m */
} path_limits;

/* Tool poses p (count, 3), R (count, 3, 3) of joint coordinates q (count, joints). */
void path_forward(const path_arm* arm, int32_t count, const double* q, double* p, double* R);

/* Torques tau (count, joints) at q, v, a (count, joints) each. */
void path_torques(const path_arm* arm, int32_t count, const double* q, const double* v,
                  const double* a, double* tau);

/* Coordinates q (count + 1, coordinates) that take the tool from row 0, where it is, through poses
 * p, R (count, ...): the nearest ones to the line of the joints to `goal` (coordinates), or, where
 * that is NULL, to the path before. rows: 3, position only; 6. Returns how many poses were reached.
 */
int32_t path_trace(const path_arm* arm, int32_t rows, int32_t count, const double* p,
                   const double* R, const double* goal, double* q);

/* Second derivatives m (nodes, columns) of the cubic spline through y (nodes, columns), `step`
 * apart; at both ends those of the cubic through the four nodes there. */
void path_spline(int32_t nodes, int32_t columns, double step, const double* y, double* m);

/* The rows of path_time at places sigma (count) of a curve whose s over sigma has ramps
 * (timed_path.py): max_c (count), firsts (3, count, F) and thirds (3, count, G). F is the number of
 * coordinates, of limited torques unless arm is NULL, and 1 where the tool is limited; G the same
 * without torques. */
void path_rows(const path_arm* arm, const path_curve* curve, const path_limits* limits, double ramp,
               int32_t count, const double* sigma, double* max_c, double* firsts, double* thirds);

/* Write `keeps` (intervals): factors of c, 1 or less, with which the timing keeps all limits. The
 * limits are checked at `looks` evenly spread places of each piece, both ends among them.
 * jerk_margin: factor of jerks. */
void path_keeps(const path_arm* arm, const path_curve* curve, const path_limits* limits,
                double ramp, int32_t intervals, const double* coefficients, int32_t looks,
                double jerk_margin, double* keeps);

/* Timing of least duration: c = (ds/dt)^2 over s in [0, 1], a quadratic spline of `intervals` equal
 * pieces, of which `coefficients` (intervals + 2) are found. At three points of each piece, its
 * begin, middle and end, (points = 3 intervals), with rows f (3, points, firsts) and
 * g (3, points, thirds):
 *
 *   c <= max_c,   |f0 + f1 c + f2 dc/ds| <= 1,   |g0 c + g1 dc/ds + g2 d2c/ds2| sqrt(c) <= 1.
 *
 * gap: how much longer than the shortest it may be, in parts of it. Returns -1, or the point at
 * which not even rest keeps the limits. */
int32_t path_time(int32_t intervals, const double* max_c, int32_t firsts, const double* first_rows,
                  int32_t thirds, const double* third_rows, double gap, double* coefficients);

#ifdef __cplusplus
}
#endif
#endif
