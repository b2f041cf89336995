// Included first in the unit of kernels. For a card, clang then compiles all functions for it:
// those of the core, and of the standard library those that are templates.
#pragma once

// See state_rows.hpp.
#define ARM_STATES_IN_ROWS

#ifdef __CUDA__
#include <time.h>

#include <array>
#include <atomic>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <new>
#include <optional>
#include <type_traits>
#include <utility>
#pragma clang force_cuda_host_device begin
#include <tuple>
#include <vector>
// No other file calls the functions up to kernel.hpp, so those that no kernel calls are dropped.
#pragma clang attribute push(__attribute__((internal_linkage)), apply_to = function)
#endif
