// Cost of a handshake between two threads: a counter goes to the other thread and back.
// Prints the time of one round trip [ns].

#include <atomic>
#include <chrono>
#include <cstdio>
#include <thread>

namespace {

void wait_for(const std::atomic<long>& counter, long value) {
  while (counter.load(std::memory_order_acquire) < value) {
#ifdef __x86_64__
    __builtin_ia32_pause();
#endif
  }
}

}  // namespace

int main() {
  constexpr long kTrips = 50'000;
  alignas(64) static std::atomic<long> there, back;
  std::jthread other([] {
    for (long k = 1; k <= kTrips; ++k) {
      wait_for(there, k);
      back.store(k, std::memory_order_release);
    }
  });
  const auto began = std::chrono::steady_clock::now();
  for (long k = 1; k <= kTrips; ++k) {
    there.store(k, std::memory_order_release);
    wait_for(back, k);
  }
  const std::chrono::duration<double, std::nano> spent = std::chrono::steady_clock::now() - began;
  std::printf("%g\n", spent.count() / kTrips);
}
