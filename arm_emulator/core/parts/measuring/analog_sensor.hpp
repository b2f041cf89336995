// A sensor of one quantity x with amplifier and converter: a current, a torque, an axis of an
// inertial measurement unit.
//
//   y = (1 + gain_error) x + offset + drift t + noise n, limited to +-range, rounded to a multiple
//   of `resolution`
//
// A drift that ends leaves its offset; a reset removes it.
#pragma once

#include "numerics/noise.hpp"

namespace arm {

struct AnalogSensor {
  bool present = false;
  double gain_error = 0.0;
  double noise = 0.0;       // standard deviation
  double range = 0.0;       // 0: none
  double resolution = 0.0;  // 0: none
  double held = 0.0;        // probability that a sample repeats the reading before
  double drift = 0.0;       // per s
  double offset = 0.0;      // with what has drifted
  int delay = 0;            // servo periods

  double read(double x, const Noise& noises, std::int64_t number) const {
    if (!present) return x;
    double y = x + gain_error * x + offset;
    if (noise != 0.0) y += noise * noises.normal(number);
    if (range > 0.0) y = clamp(y, range);
    if (resolution > 0.0) y = resolution * __builtin_floor(y / resolution + 0.5);
    return y;
  }
};

}  // namespace arm
