// Kernels of the tests: one source for a card and for the processor.

#ifdef __CUDA__
typedef long long int64;
#define KERNEL(name, Given)                                                                   \
  static __attribute__((device)) void name##_thread(int64 thread, const Given& given);        \
  extern "C" __attribute__((global)) void name(int64 threads, Given given) {                  \
    const int64 block = __nvvm_read_ptx_sreg_ctaid_x(), size = __nvvm_read_ptx_sreg_ntid_x(); \
    const int64 thread = block * size + __nvvm_read_ptx_sreg_tid_x();                         \
    if (thread < threads) name##_thread(thread, given);                                       \
  }                                                                                           \
  static __attribute__((device)) void name##_thread(int64 thread, const Given& given)
#else
#include <cstdint>
using int64 = std::int64_t;
#define EXPORTED extern "C" __attribute__((visibility("default")))
#define KERNEL(name, Given)                                                  \
  static void name##_thread(int64 thread, const Given& given);               \
  EXPORTED void name(int64 first, int64 threads, void** arguments) {         \
    const Given& given = *static_cast<const Given*>(arguments[0]);           \
    for (int64 k = first; k < first + threads; ++k) name##_thread(k, given); \
  }                                                                          \
  static void name##_thread(int64 thread, const Given& given)
#endif

extern "C" {
#ifdef __CUDA__
__attribute__((device))
#else
__attribute__((visibility("default")))
#endif
double offsets[3] = {0.5, 0.25, 0.125};
}

struct Scaled {
  double* numbers;
  double factor;
  int64 add;
};

// numbers[k] = factor * numbers[k] + add + offsets[k % 3]
KERNEL(scale, Scaled) {
  given.numbers[thread] =
      given.factor * given.numbers[thread] + static_cast<double>(given.add) + offsets[thread % 3];
}

#ifndef __CUDA__
// Adds the arguments that a launch hands over.
EXPORTED void take(int64 first, int64 threads, void** arguments) {
  double* result = *static_cast<double**>(arguments[0]);
  const float single = *static_cast<float*>(arguments[3]);
  for (int64 k = first; k < first + threads; ++k)
    result[k] = static_cast<double>(*static_cast<int64*>(arguments[1])) +
                *static_cast<double*>(arguments[2]) + single;
}
#endif
