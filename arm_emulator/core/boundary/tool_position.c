#include "tool_position.h"

#include <math.h>

static double position_of(const tool_joint* joint, int64_t drives, const double* q,
                          int64_t stride) {
  double position = joint->q_0;
  for (int64_t j = 0; j < drives; ++j) position += joint->share[j] * q[j * stride];
  return position;
}

void tool_positions(const tool_chain* chain, const double* q, int64_t stride, int64_t count,
                    double* p) {
  if (!chain || !q || !p || (chain->joints && !chain->joint)) return;
  for (int64_t i = 0; i < count; ++i) {
    double x = chain->p[0], y = chain->p[1], z = chain->p[2];
    for (int32_t k = 0; k < chain->joints; ++k) {
      const tool_joint* joint = chain->joint + k;
      const double position = position_of(joint, chain->drives, q + i, stride);
      const double angle = joint->theta_0 + (joint->slides ? 0.0 : position);
      const double c = cos(angle), s = sin(angle);
      const double x_1 = c * x - s * y, y_1 = s * x + c * y;
      const double z_1 = z + (joint->slides ? position : 0.0);
      const double y_2 = joint->cos_alpha * y_1 - joint->sin_alpha * z_1;
      x = joint->p[0] + joint->cos_gamma * x_1 - joint->sin_gamma * y_2;
      y = joint->p[1] + joint->sin_gamma * x_1 + joint->cos_gamma * y_2;
      z = joint->p[2] + joint->sin_alpha * y_1 + joint->cos_alpha * z_1;
    }
    for (int64_t axis = 0; axis < 3; ++axis) {
      const double* R = chain->R + 3 * axis;
      p[axis * count + i] = R[0] * x + R[1] * y + R[2] * z;
    }
  }
}
