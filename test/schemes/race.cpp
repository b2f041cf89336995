// Concurrent use of all data of the core that two threads share, for ThreadSanitizer. Built by
// test_threads.py behind a scene's unit.

#include <atomic>
#include <cstddef>
#include <cstdio>
#include <thread>
#include <vector>

#include "real_time.cpp"

int main() {
  constexpr int N = Scene::N;
  double voltage[N], q[N] = {}, v[N] = {};
  arm_joint_command commands[N];
  for (int j = 0; j < N; ++j) {
    voltage[j] = 5.0 * (j % 2 ? 1 : -1);
    commands[j] = {ARM_VOLTAGE, 1, voltage[j]};
  }

  const arm_options options = {
      .size = sizeof options, .core = -1, .step = 1e-4, .steps_per_period = 2};
  arm_machine* machine = arm_new(&options);
  arm_reset(machine, q, v);
  for (int burst = 0; burst < 200; ++burst)
    if (arm_advance(machine, voltage, 25) != ARM_OK) return 1;
  arm_reset(machine, q, v);

  // The real-time loop, its commands, its snapshots and its figures, from two more threads.
  const tick_machine at = {.size = sizeof at,
                           .joints = N,
                           .machine = machine,
                           .exchange = arm_exchange,
                           .get_truth = arm_get_truth};
  const arm_real_time_options loop_options = {.size = sizeof loop_options,
                                              .at = &at,
                                              .join_schedule = arm_join_schedule,
                                              .period = 200'000,
                                              .core = -1,
                                              .imus = 0};
  arm_real_time* loop = arm_real_time_new(&loop_options);
  if (!loop) return 2;
  double energy, torques[N];
  arm_joint_measurement measured[N];
  arm_snapshot snapshot = {};
  snapshot.size = sizeof snapshot;
  snapshot.truth.size = sizeof snapshot.truth;
  snapshot.truth.energy = &energy;
  snapshot.truth.gear_torque = torques;
  snapshot.joint = measured;
  for (int round = 0; round < 3; ++round) {
    arm_real_time_start(loop, 0);
    std::atomic<bool> enough = false;
    std::jthread commander([&] {
      arm_command command = {.size = sizeof command, .came = 0, .tick = 0, .joint = commands};
      for (; !enough.load(); ++command.tick) {
        arm_real_time_command(loop, &command);
        arm_real_time_figures figures;
        arm_real_time_get_figures(loop, &figures);
      }
    });
    // Changed between two ticks now and then, while commands go on coming.
    for (int taken = 0, change = 50; taken < 300;) {
      taken += arm_real_time_take(loop, 0, &snapshot);
      if (taken < change) continue;
      change += 50;
      arm_real_time_stop(loop);
      arm_power(machine, change % 100 == 0);
      arm_real_time_go_on(loop);
    }
    enough.store(true);
    arm_real_time_stop(loop);
    while (arm_real_time_take(loop, 0, &snapshot)) {
    }
    arm_reset(machine, q, v);
  }
  arm_real_time_delete(loop);
  arm_delete(machine);
  std::puts("done");
}
