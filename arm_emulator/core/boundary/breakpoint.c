#include "breakpoint.h"

#include <math.h>
#include <string.h>

static double number(const breakpoint* one, const breakpoint_step* step) {
  const char* at = one->row + step->offset;
  if (step->code == BREAKPOINT_DOUBLE) {
    double value;
    memcpy(&value, at, sizeof value);
    return value;
  }
  if (step->code == BREAKPOINT_INT64) {
    int64_t value;
    memcpy(&value, at, sizeof value);
    return (double)value;
  }
  uint32_t value;
  memcpy(&value, at, sizeof value);
  return value;
}

static double tool(const breakpoint* one, int64_t axis) {
  double x = one->p[0], y = one->p[1], z = one->p[2];
  for (int32_t k = 0; k < one->joints; ++k) {
    const breakpoint_joint* joint = one->joint + k;
    double q = joint->q_0, of_drive;
    for (int32_t j = 0; j < one->drives; ++j) {
      memcpy(&of_drive, one->row + one->q + j * (int64_t)sizeof of_drive, sizeof of_drive);
      q += joint->share[j] * of_drive;
    }
    const double angle = joint->theta_0 + (joint->slides ? 0.0 : q);
    const double c = cos(angle), s = sin(angle);
    const double x_1 = c * x - s * y, y_1 = s * x + c * y, z_1 = z + (joint->slides ? q : 0.0);
    const double y_2 = joint->cos_alpha * y_1 - joint->sin_alpha * z_1;
    x = joint->p[0] + joint->cos_gamma * x_1 - joint->sin_gamma * y_2;
    y = joint->p[1] + joint->sin_gamma * x_1 + joint->cos_gamma * y_2;
    z = joint->p[2] + joint->sin_alpha * y_1 + joint->cos_alpha * z_1;
  }
  const double* R = one->R + 3 * axis;
  return R[0] * x + R[1] * y + R[2] * z;
}

/* Two infinities have no distance. */
static double difference(double a, double b) { return a == b ? 0.0 : a - b; }

static double of_two(int32_t code, double a, double b) {
  switch (code) {
    case BREAKPOINT_ADD:
      return a + b;
    case BREAKPOINT_SUBTRACT:
      return difference(a, b);
    case BREAKPOINT_MULTIPLY:
      return a * b;
    case BREAKPOINT_DIVIDE:
      return b != 0.0 ? a / b : NAN;
    case BREAKPOINT_LEAST:
      return b < a ? b : a;
    default:
      return b > a ? b : a;
  }
}

static double of_one(int32_t code, double a) {
  switch (code) {
    case BREAKPOINT_ABS:
      return fabs(a);
    case BREAKPOINT_SQRT:
      return a >= 0.0 ? sqrt(a) : NAN;
    case BREAKPOINT_AT_LEAST_0:
      return a >= 0.0;
    case BREAKPOINT_ABOVE_0:
      return a > 0.0;
    default:
      return a == 0.0;
  }
}

int breakpoint_holds(breakpoint* one, const arm_machine* machine) {
  if (!one || !machine || !one->steps || !one->step) return 0;
  one->measure(machine, one->measurement);
  one->get_truth(machine, one->truth);
  one->head->time = one->truth->time;
  one->head->tick = one->measurement->tick;
  double stack[BREAKPOINT_DEEPEST];
  int32_t depth = 0;
  for (int32_t k = 0; k < one->steps; ++k) {
    const breakpoint_step* step = one->step + k;
    if (step->code <= BREAKPOINT_TOOL) {
      if (depth == BREAKPOINT_DEEPEST) return 0;
      stack[depth++] = step->code == BREAKPOINT_CONSTANT ? step->value
                       : step->code == BREAKPOINT_TOOL   ? tool(one, step->offset)
                                                         : number(one, step);
    } else if (step->code >= BREAKPOINT_ADD && step->code != BREAKPOINT_ABS &&
               step->code != BREAKPOINT_SQRT && step->code <= BREAKPOINT_LARGEST) {
      if (depth < 2) return 0;
      --depth;
      stack[depth - 1] = of_two(step->code, stack[depth - 1], stack[depth]);
    } else {
      if (depth < 1) return 0;
      stack[depth - 1] = of_one(step->code, stack[depth - 1]);
    }
  }
  return depth == 1 && stack[0] != 0.0;
}

void breakpoint_take(void* with, const arm_machine* machine) {
  breakpoint* one = with;
  if (!one || !machine) return;
  const int holds = breakpoint_holds(one, machine);
  if (holds && !one->held) {
    one->tick = one->measurement->tick;
    __atomic_store_n(&one->hit, 1, __ATOMIC_RELEASE);
  }
  one->held = holds;
}
