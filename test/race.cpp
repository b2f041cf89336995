// Everything in the core that two threads touch, at once, for ThreadSanitizer to watch. Built by
// test_threads.py behind a scene's unit.

#include <cstdio>

int main() {
  double voltage[N];
  for (int j = 0; j < N; ++j) voltage[j] = 5.0 * (j % 2 ? 1 : -1);
  double q[N] = {}, v[N] = {};

  TheMachine* machine = arm_new(1e-4, -1);
  arm_reset(machine, q, v);
  for (int burst = 0; burst < 200; ++burst)
    if (arm_advance(machine, voltage, 25) >= 0) return 1;
  arm_reset(machine, q, v);

  // The real-time loop, its commands, its snapshots and its figures, from two more threads.
  TheRealTime* loop = arm_real_time_new(machine, 200'000, 2, -1);
  for (int round = 0; round < 3; ++round) {
    arm_real_time_start(loop, 0);
    std::atomic<bool> enough = false;
    std::jthread commander([&] {
      for (int k = 0; !enough.load(); ++k) {
        arm_real_time_command(loop, k, voltage);
        arm_real_time_power(loop, k % 7 != 0);
        TheRealTime::Status status;
        arm_real_time_status(loop, &status);
      }
    });
    arm::Snapshot<N> snapshot;
    for (int taken = 0; taken < 300;) taken += arm_real_time_take(loop, &snapshot);
    enough.store(true);
    arm_real_time_stop(loop);
    while (arm_real_time_take(loop, &snapshot)) {
    }
    arm_reset(machine, q, v);
  }
  arm_real_time_delete(loop);
  arm_delete(machine);
  std::puts("done");
}
