// Memory for objects that live as long as their fleet: [next, end) of what its owner has allotted.
// A card has it; on a processor it takes the place of the heap where a test includes it.
#pragma once

#include <cstddef>
#include <new>

#ifdef __CUDA__
#define ARM_OF_CARD __attribute__((device))
#else
#define ARM_OF_CARD
#endif

extern "C" {
ARM_OF_CARD __attribute__((visibility("default"))) unsigned long long arm_pool[2] = {0, 0};
}

static ARM_OF_CARD void* take_from_pool(std::size_t bytes) {
  constexpr std::size_t apart = 256;
  const unsigned long long at =
      __atomic_fetch_add(&arm_pool[0], (bytes + apart - 1) / apart * apart, __ATOMIC_RELAXED);
  if (at + bytes > arm_pool[1]) __builtin_trap();
  return reinterpret_cast<void*>(at);
}

ARM_OF_CARD void* operator new(std::size_t bytes) { return take_from_pool(bytes); }
ARM_OF_CARD void* operator new[](std::size_t bytes) { return take_from_pool(bytes); }
ARM_OF_CARD void* operator new(std::size_t bytes, std::align_val_t) {
  return take_from_pool(bytes);
}
ARM_OF_CARD void* operator new[](std::size_t bytes, std::align_val_t) {
  return take_from_pool(bytes);
}
ARM_OF_CARD void operator delete(void*) noexcept {}
ARM_OF_CARD void operator delete[](void*) noexcept {}
ARM_OF_CARD void operator delete(void*, std::size_t) noexcept {}
ARM_OF_CARD void operator delete[](void*, std::size_t) noexcept {}
ARM_OF_CARD void operator delete(void*, std::align_val_t) noexcept {}
ARM_OF_CARD void operator delete(void*, std::size_t, std::align_val_t) noexcept {}
