// Arguments and results of the equations of a drive (drive.hpp).
#pragma once

namespace arm {

// Inputs of a drive with n states and M parts with modes.
template <int n, int M, class X>
struct DriveInput {
  X z[n > 0 ? n : 1] = {};
  X q{}, v{}, u{};
  X offset[M > 0 ? M : 1] = {};
};

template <int n, class X>
struct DriveRates {
  X f[n > 0 ? n : 1] = {};
  X g{};
};

}  // namespace arm
