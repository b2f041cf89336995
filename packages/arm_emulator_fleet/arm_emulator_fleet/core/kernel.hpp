// Functions that run once per thread: on a card in its threads, on a processor one after the other.
#pragma once

#include <cstddef>
#include <cstdint>

// ARM_KERNEL(name, call) { ... }: the body is that of thread `thread`, under the arguments `call`.
// ARM_ADDRESS(name, function): the variable `name` has the address of a function where it runs.
#ifdef __CUDA__

#pragma clang attribute pop

#define ARM_KERNEL(name)                                                                 \
  static void name##_of(const name##_call& call, std::int64_t thread);                   \
  extern "C" __attribute__((global)) void name(std::int64_t threads, name##_call call) { \
    const std::int64_t thread =                                                          \
        std::int64_t{__nvvm_read_ptx_sreg_ctaid_x()} * __nvvm_read_ptx_sreg_ntid_x() +   \
        __nvvm_read_ptx_sreg_tid_x();                                                    \
    if (thread < threads) name##_of(call, thread);                                       \
  }                                                                                      \
  static void name##_of([[maybe_unused]] const name##_call& call,                        \
                        [[maybe_unused]] std::int64_t thread)

#define ARM_ADDRESS(name, function)                            \
  extern "C" {                                                 \
  __attribute__((device)) decltype(&function) name = function; \
  }

#pragma clang force_cuda_host_device end
#include "pool.hpp"
inline __attribute__((device)) void* operator new(std::size_t, void* at) noexcept { return at; }
inline __attribute__((device)) void operator delete(void*, void*) noexcept {}
#pragma clang force_cuda_host_device begin

#else

#define ARM_KERNEL(name)                                                                           \
  static void name##_of(const name##_call& call, std::int64_t thread);                             \
  extern "C" __attribute__((visibility("default"))) void name(                                     \
      std::int64_t first, std::int64_t threads, void** arguments) {                                \
    const auto& call = *static_cast<const name##_call*>(arguments[0]);                             \
    for (std::int64_t thread = first; thread < first + threads; ++thread) name##_of(call, thread); \
  }                                                                                                \
  static void name##_of([[maybe_unused]] const name##_call& call,                                  \
                        [[maybe_unused]] std::int64_t thread)

#define ARM_ADDRESS(name, function)                                           \
  extern "C" {                                                                \
  __attribute__((visibility("default"))) decltype(&function) name = function; \
  }

#endif
