// Real time: a thread of its own that wakes at absolute deadlines, one per servo period, and takes
// the machine through the period that has just passed: the clock of tick.h for real time, in a
// library of its own. One serves the machines of every scene.
//
// The threads share no lock. Commands arrive through a sequence-checked cell in which the newest
// wins; states leave through a ring with one writer and one reader. Periods whose deadline has
// passed are lost to logical time and counted, not repeated: no controller could answer such a
// burst.
#include "real_time.h"

#include <pthread.h>
#include <sched.h>
#include <sys/eventfd.h>
#include <sys/mman.h>
#include <time.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <iterator>
#include <thread>
#include <vector>

#include "tick.c"

namespace arm_loop {

// A command that one thread writes and another reads whole, or not at all (sequence lock). The
// reader never waits for the writer: it keeps what it had.
class Cell {
 public:
  Cell(int joints, int inputs)
      : modes_(joints), values_(joints), further_(static_cast<std::size_t>(inputs) * joints) {}

  void write(const arm_command& command) {
    const std::uint32_t s = sequence_.load(std::memory_order_relaxed);
    sequence_.store(s + 1, std::memory_order_relaxed);
    std::atomic_thread_fence(std::memory_order_release);
    tick_.store(command.tick, std::memory_order_relaxed);
    for (std::size_t j = 0; j < values_.size(); ++j) {
      const arm_joint_command& joint = command.joint[j];
      modes_[j].store(
          static_cast<std::uint64_t>(joint.enable) << 32 | static_cast<std::uint32_t>(joint.mode),
          std::memory_order_relaxed);
      values_[j].store(joint.value, std::memory_order_relaxed);
    }
    for (std::size_t k = 0; k < further_.size(); ++k)
      further_[k].store(command.further ? command.further[k] : 0.0, std::memory_order_relaxed);
    sequence_.store(s + 2, std::memory_order_release);
  }

  // A command: entries of joints, and its further inputs.
  struct Entries {
    std::vector<arm_joint_command> joints;
    std::vector<double> further;
  };

  // Leaves `command` and its entries unchanged during a write. `scratch` has room for as many.
  void read(arm_command& command, Entries& entries, Entries& scratch) const {
    const std::uint32_t s = sequence_.load(std::memory_order_acquire);
    const std::int64_t answered = tick_.load(std::memory_order_relaxed);
    for (std::size_t j = 0; j < values_.size(); ++j) {
      const std::uint64_t mode = modes_[j].load(std::memory_order_relaxed);
      scratch.joints[j] = {static_cast<std::int32_t>(mode & 0xffffffff),
                           static_cast<std::uint32_t>(mode >> 32),
                           values_[j].load(std::memory_order_relaxed)};
    }
    for (std::size_t k = 0; k < further_.size(); ++k)
      scratch.further[k] = further_[k].load(std::memory_order_relaxed);
    std::atomic_thread_fence(std::memory_order_acquire);
    if (s % 2 == 1 || sequence_.load(std::memory_order_relaxed) != s) return;
    command.tick = answered;
    entries = scratch;  // of equal lengths: nothing is allocated
  }

 private:
  std::atomic<std::uint32_t> sequence_ = 0;
  std::atomic<std::int64_t> tick_ = -1;
  std::vector<std::atomic<std::uint64_t>> modes_;  // enable, mode
  std::vector<std::atomic<double>> values_, further_;
};

// The arrays of an arm_truth, with an entry per joint.
constexpr double* arm_truth::* kRows[] = {&arm_truth::current,     &arm_truth::motor_angle,
                                          &arm_truth::motor_speed, &arm_truth::q,
                                          &arm_truth::v,           &arm_truth::gear_torque};

// Snapshots that one thread writes; each reader, a thread of its own, takes all of them.
class Ring {
 public:
  Ring(int joints, int imus, int readings, int inputs, int readers)
      : N(static_cast<std::size_t>(joints)),
        M(static_cast<std::size_t>(imus)),
        R(static_cast<std::size_t>(readings)),
        I(static_cast<std::size_t>(inputs)),
        numbers_(kSnapshots * (1 + (std::size(kRows) + 1 + R + I) * N)),
        measured_(kSnapshots * N),
        sensors_(kSnapshots * N),
        units_(kSnapshots * M),
        snapshots_(kSnapshots),
        taken_(readers > 1 ? 2 : 1) {
    double* next = numbers_.data();
    for (std::size_t k = 0; k < kSnapshots; ++k) {
      arm_snapshot& snapshot = snapshots_[k] = {};
      snapshot.truth.size = sizeof snapshot.truth;
      snapshot.truth.energy = next++;
      for (const auto row : kRows) snapshot.truth.*row = next, next += N;
      snapshot.current_d = next, next += N;
      snapshot.readings = next, next += R * N;
      snapshot.further = next, next += I * N;
      snapshot.joint = measured_.data() + k * N;
      snapshot.sensors = sensors_.data() + k * N;
      snapshot.imu = units_.data() + k * M;
    }
  }

  // Place of the next snapshot, null if a reader has not taken the oldest one.
  arm_snapshot* free() {
    const std::size_t w = written_.load(std::memory_order_relaxed);
    for (const Count& taken : taken_)
      if (w - taken.of.load(std::memory_order_acquire) == kSnapshots) return nullptr;
    return &snapshots_[w % kSnapshots];
  }
  void publish() { written_.fetch_add(1, std::memory_order_release); }

  // Copy the arrays of a measurement, or of a snapshot; those of `to` may be null.
  void copy_measured(const auto& from, arm_snapshot& to) const {
    const auto copy = [](const auto* numbers, std::size_t count, auto* out) {
      if (out) std::copy_n(numbers, count, out);
    };
    copy(from.joint, N, to.joint), copy(from.sensors, N, to.sensors), copy(from.imu, M, to.imu);
    copy(from.current_d, N, to.current_d), copy(from.readings, R * N, to.readings);
    copy(from.further, I * N, to.further);
  }

  bool has(int reader) const {
    return reader >= 0 && static_cast<std::size_t>(reader) < taken_.size();
  }

  std::int64_t skip(int reader) {
    std::atomic<std::size_t>& taken = taken_[static_cast<std::size_t>(reader)].of;
    const std::size_t w = written_.load(std::memory_order_acquire);
    std::int64_t spent = 0;
    std::size_t t = taken.load(std::memory_order_relaxed);
    for (; t + 1 < w; ++t) spent += snapshots_[t % kSnapshots].spent;
    taken.store(t, std::memory_order_release);
    return spent;
  }

  bool take(int reader, arm_snapshot& out) {
    std::atomic<std::size_t>& taken = taken_[static_cast<std::size_t>(reader)].of;
    const std::size_t t = taken.load(std::memory_order_relaxed);
    if (t == written_.load(std::memory_order_acquire)) return false;
    const arm_snapshot& from = snapshots_[t % kSnapshots];
    out.tick = from.tick, out.answered = from.answered;
    out.lateness = from.lateness, out.spent = from.spent;
    out.truth.fault = from.truth.fault, out.truth.time = from.truth.time;
    if (out.truth.energy) *out.truth.energy = *from.truth.energy;
    for (const auto row : kRows)
      if (out.truth.*row) std::copy_n(from.truth.*row, N, out.truth.*row);
    copy_measured(from, out);
    taken.store(t + 1, std::memory_order_release);
    return true;
  }

 private:
  static constexpr std::size_t kSnapshots = 16384;  // 16 s at 1 kHz: room for a reader that is late

  const std::size_t N, M, R, I;  // joints, inertial measurement units, readings, further inputs
  std::vector<double> numbers_;
  std::vector<arm_joint_measurement> measured_;
  std::vector<arm_joint_sensors> sensors_;
  std::vector<arm_imu_measurement> units_;
  std::vector<arm_snapshot> snapshots_;
  struct alignas(64) Count {
    std::atomic<std::size_t> of = 0;
  };
  std::vector<Count> taken_;  // by each reader
  alignas(64) std::atomic<std::size_t> written_ = 0;
};

// Statistics of the thread's late wake-ups.
class Lateness {
 public:
  void note(std::int64_t lateness) {
    if (lateness > worst_.load(std::memory_order_relaxed)) worst_.store(lateness);
    const std::int64_t bin = lateness / 1000;
    bins_[bin < kBins ? bin : kBins - 1].fetch_add(1, std::memory_order_relaxed);
  }
  void clear() {
    worst_.store(0);
    for (auto& bin : bins_) bin.store(0);
  }
  std::int64_t largest() const { return worst_.load(); }

  // Quantile `part` of the lateness [ns], with a resolution of 1 us.
  std::int64_t quantile(double part) const {
    std::int64_t total = 0, below = 0;
    for (const auto& bin : bins_) total += bin.load(std::memory_order_relaxed);
    for (int bin = 0; bin < kBins; ++bin) {
      below += bins_[bin].load(std::memory_order_relaxed);
      if (static_cast<double>(below) >= part * static_cast<double>(total))
        return (bin + 1) * 1000LL;
    }
    return kBins * 1000LL;
  }

 private:
  static constexpr int kBins = 4096;  // by the microsecond, the last bin is "more"
  std::atomic<std::int64_t> worst_ = 0;
  std::atomic<std::uint32_t> bins_[kBins] = {};
};

std::int64_t now() {
  timespec t;
  clock_gettime(CLOCK_MONOTONIC, &t);
  return t.tv_sec * 1'000'000'000LL + t.tv_nsec;
}

void sleep_until(std::int64_t when) {
  const timespec t = {when / 1'000'000'000LL, when % 1'000'000'000LL};
  while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &t, nullptr) != 0) {
  }
}

}  // namespace arm_loop

using namespace arm_loop;

struct arm_real_time {
  static constexpr std::int64_t kOldAfter = 2;  // servo periods

  explicit arm_real_time(const arm_real_time_options& given)
      : options(given),
        bell(eventfd(0, EFD_NONBLOCK)),
        cell(options.at->joints, options.inputs),
        ring(options.at->joints, options.imus, options.readings, options.inputs, options.readers) {}

  ~arm_real_time() {
    stop();
    close(bell);
  }

  void start(std::int64_t at) {
    stop();
    tick.store(at);
    due = now();
    go_on();
  }

  void go_on() {
    stop();
    stopping.store(false);
    tick_machine at = *options.at;
    at.tick = tick.load();
    thread = std::jthread([this, at] { run(at); });
  }

  void stop() {
    stopping.store(true);
    if (!thread.joinable()) return;
    thread.join();
    options.join_schedule(options.at->machine);
  }

  void run(tick_machine at) {
    become_real_time();
    const auto joints = static_cast<std::size_t>(options.at->joints);
    const std::size_t further = joints * static_cast<std::size_t>(options.inputs);
    const Cell::Entries none = {std::vector<arm_joint_command>(joints),
                                std::vector<double>(further)};
    Cell::Entries entries = none, scratch = none;
    std::vector<arm_joint_measurement> measured(joints);
    arm_command command = {};
    command.size = sizeof command, command.tick = -1, command.joint = entries.joints.data();
    command.further = entries.further.data();
    std::vector<arm_joint_sensors> sensors(joints);
    std::vector<arm_imu_measurement> units(static_cast<std::size_t>(options.imus));
    arm_measurement measurement = {};
    measurement.size = sizeof measurement, measurement.answered = -1;
    measurement.joint = measured.data(), measurement.sensors = sensors.data();
    measurement.imu = units.data();
    std::vector<double> current_d(joints);
    std::vector<double> readings(joints * static_cast<std::size_t>(options.readings));
    std::vector<double> applied(further);
    measurement.current_d = current_d.data(), measurement.readings = readings.data();
    measurement.further = applied.data();
    at.measurement = &measurement;
    while (!stopping.load(std::memory_order_relaxed)) {
      due += options.period;
      sleep_until(due);
      const std::int64_t lateness = now() - due;
      late.note(lateness);
      if (lateness >= options.period) {
        const std::int64_t lost = lateness / options.period;
        lost_periods.fetch_add(lost);
        due += lost * options.period;
      }
      cell.read(command, entries, scratch);
      if (command.tick >= 0 && at.tick - command.tick > kOldAfter) old_commands.fetch_add(1);
      const std::int64_t began = now();
      int result = tick_exchange(&at, &command);
      if (result == ARM_REFUSED) {  // an invalid command: nothing is applied
        for (arm_joint_command& joint : entries.joints) joint.enable = 0;
        command.tick = -1;
        result = tick_exchange(&at, &command);
      }
      const std::int64_t spent = now() - began;
      tick.store(at.tick);
      publish(at, command.tick, lateness, spent);
      if (result != ARM_OK || tick_stops(&at)) return;
    }
  }

  void publish(const tick_machine& at, std::int64_t answered, std::int64_t lateness,
               std::int64_t spent) {
    arm_snapshot* const out = ring.free();
    if (!out) {
      unread.fetch_add(1);
      return;
    }
    out->tick = at.tick, out->answered = answered;
    out->lateness = lateness, out->spent = spent;
    at.get_truth(at.machine, &out->truth);
    ring.copy_measured(*at.measurement, *out);
    ring.publish();
    const std::uint64_t unit = 1;
    [[maybe_unused]] const auto rung = ::write(bell, &unit, sizeof unit);
  }

  // As far as the system permits; the figures report it.
  void become_real_time() {
    sched_param priority = {};
    priority.sched_priority = 50;
    const bool permitted = pthread_setschedparam(pthread_self(), SCHED_FIFO, &priority) == 0;
    fifo.store(options.join_schedule(options.at->machine) && permitted);
#ifdef MCL_ONFAULT
    locked.store(mlockall(MCL_CURRENT | MCL_FUTURE | MCL_ONFAULT) == 0);
#endif
    if (options.core < 0) return;
    cpu_set_t cores;
    CPU_ZERO(&cores);
    CPU_SET(static_cast<unsigned>(options.core), &cores);
    pthread_setaffinity_np(pthread_self(), sizeof cores, &cores);
  }

  const arm_real_time_options options;
  const int bell;
  Cell cell;
  Ring ring;
  Lateness late;
  std::atomic<bool> stopping = false;
  std::int64_t due = 0;  // ns, when the newest period ended or should have
  std::atomic<std::int64_t> tick = 0, lost_periods = 0, old_commands = 0, unread = 0;
  std::atomic<std::int64_t> fifo = 0, locked = 0;
  std::jthread thread;  // last: it uses all of the above
};

#pragma GCC visibility push(default)

arm_real_time* arm_real_time_new(const arm_real_time_options* options) {
  const tick_machine* at = options ? options->at : nullptr;
  const bool sound = at && options->size >= sizeof *options && at->joints > 0 && at->machine &&
                     at->exchange && at->get_truth && options->join_schedule &&
                     options->period > 0 && options->core >= -1 && options->imus >= 0 &&
                     options->readings >= 0 && options->inputs >= 0 && options->readers >= 0 &&
                     options->readers <= 2;
  return sound ? new arm_real_time(*options) : nullptr;
}
void arm_real_time_delete(arm_real_time* loop) { delete loop; }
void arm_real_time_start(arm_real_time* loop, std::int64_t tick) {
  if (loop) loop->start(tick);
}
void arm_real_time_stop(arm_real_time* loop) {
  if (loop) loop->stop();
}
void arm_real_time_go_on(arm_real_time* loop) {
  if (loop) loop->go_on();
}
void arm_real_time_command(arm_real_time* loop, const arm_command* command) {
  if (loop && command && command->joint) loop->cell.write(*command);
}
int arm_real_time_take(arm_real_time* loop, std::int32_t reader, arm_snapshot* out) {
  return loop && out && out->size >= sizeof *out && out->truth.size >= sizeof out->truth &&
         loop->ring.has(reader) && loop->ring.take(reader, *out);
}
std::int64_t arm_real_time_skip(arm_real_time* loop, std::int32_t reader) {
  return loop && loop->ring.has(reader) ? loop->ring.skip(reader) : 0;
}
int arm_real_time_descriptor(const arm_real_time* loop) { return loop ? loop->bell : -1; }
void arm_real_time_get_figures(const arm_real_time* loop, arm_real_time_figures* out) {
  if (!loop || !out) return;
  *out = {loop->tick.load(),    loop->lost_periods.load(), loop->old_commands.load(),
          loop->late.largest(), loop->late.quantile(0.5),  loop->late.quantile(0.99),
          loop->unread.load(),  loop->fifo.load(),         loop->locked.load()};
}
void arm_real_time_clear_figures(arm_real_time* loop) {
  if (!loop) return;
  loop->lost_periods.store(0);
  loop->old_commands.store(0);
  loop->unread.store(0);
  loop->late.clear();
}

#pragma GCC visibility pop
