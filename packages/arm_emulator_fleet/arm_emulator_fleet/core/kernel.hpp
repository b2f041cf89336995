// Functions that run once per thread: on a card in its threads, on a processor one after the other.
#pragma once

#include <cstddef>
#include <cstdint>

// ARM_KERNEL(name, call) { ... }: the body is that of thread `thread`, under the arguments `call`.
#ifdef __CUDA__

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

// Memory for objects that live as long as their fleet: [next, end) of what its owner has allotted.
extern "C" __attribute__((device)) unsigned long long arm_pool[2] = {0, 0};

inline void* take_from_pool(std::size_t bytes) {
  constexpr std::size_t apart = 256;
  const unsigned long long at =
      __atomic_fetch_add(&arm_pool[0], (bytes + apart - 1) / apart * apart, __ATOMIC_RELAXED);
  if (at + bytes > arm_pool[1]) __builtin_trap();
  return reinterpret_cast<void*>(at);
}
#pragma clang force_cuda_host_device end
__attribute__((device)) void* operator new(std::size_t bytes) { return take_from_pool(bytes); }
__attribute__((device)) void* operator new[](std::size_t bytes) { return take_from_pool(bytes); }
__attribute__((device)) void* operator new(std::size_t bytes, std::align_val_t) {
  return take_from_pool(bytes);
}
__attribute__((device)) void* operator new[](std::size_t bytes, std::align_val_t) {
  return take_from_pool(bytes);
}
__attribute__((device)) void* operator new(std::size_t, void* at) noexcept { return at; }
__attribute__((device)) void operator delete(void*) noexcept {}
__attribute__((device)) void operator delete(void*, void*) noexcept {}
__attribute__((device)) void operator delete[](void*) noexcept {}
__attribute__((device)) void operator delete(void*, std::size_t) noexcept {}
__attribute__((device)) void operator delete[](void*, std::size_t) noexcept {}
__attribute__((device)) void operator delete(void*, std::align_val_t) noexcept {}
__attribute__((device)) void operator delete(void*, std::size_t, std::align_val_t) noexcept {}
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

#endif
