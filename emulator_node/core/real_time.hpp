// Real time: a thread of its own that wakes at absolute deadlines, one per servo period, and takes
// the machine through the period that has just passed.
//
// It shares no lock with anybody. Commands come through a sequence-checked cell in which the newest
// wins; states go out through a ring with one writer and one reader. A deadline that was missed by
// whole periods is not made up for: those periods are lost to logical time and counted, since a
// burst of periods that no controller could answer would be a motion that no machine makes.
#pragma once

#include <pthread.h>
#include <sched.h>
#include <sys/eventfd.h>
#include <sys/mman.h>
#include <time.h>
#include <unistd.h>

#include <atomic>
#include <cstdint>
#include <thread>

#include "machine.hpp"

namespace arm {

// A value that one thread writes and another reads whole, or not at all (sequence lock). The reader
// never waits for the writer: it keeps what it had.
template <int N>
class Cell {
 public:
  void write(std::int64_t label, const double* values) {
    const std::uint32_t s = sequence.load(std::memory_order_relaxed);
    sequence.store(s + 1, std::memory_order_relaxed);
    std::atomic_thread_fence(std::memory_order_release);
    label_.store(label, std::memory_order_relaxed);
    for (int j = 0; j < N; ++j) values_[j].store(values[j], std::memory_order_relaxed);
    sequence.store(s + 2, std::memory_order_release);
  }

  // Leaves label and values alone if a write is under way.
  void read(std::int64_t& label, double (&values)[N]) const {
    double copy[N];
    const std::uint32_t s = sequence.load(std::memory_order_acquire);
    const std::int64_t l = label_.load(std::memory_order_relaxed);
    for (int j = 0; j < N; ++j) copy[j] = values_[j].load(std::memory_order_relaxed);
    std::atomic_thread_fence(std::memory_order_acquire);
    if (s % 2 == 1 || sequence.load(std::memory_order_relaxed) != s) return;
    label = l;
    for (int j = 0; j < N; ++j) values[j] = copy[j];
  }

 private:
  std::atomic<std::uint32_t> sequence = 0;
  std::atomic<std::int64_t> label_ = -1;
  std::atomic<double> values_[N] = {};
};

// What a servo period leaves behind: the machine at the tick that ends it.
template <int N>
struct Snapshot {
  std::int64_t tick;
  std::int64_t answered;  // tick that the voltages of the period answered; -1: none yet
  std::int64_t lateness;  // ns, of the wake-up that computed it
  std::int64_t spent;     // ns, on the steps
  std::int64_t fault;     // joint that diverged, -1: none
  double energy;          // J
  double i[N], tm[N], wm[N], q[N], v[N], T[N], V[N];
};

template <class S>
class RealTime {
 public:
  static constexpr int N = S::N;

  // Figures since `start`; the order is that of plant.py.
  struct Status {
    std::int64_t tick, lost_periods, old_commands, worst_lateness, median_lateness, p99_lateness,
        unread, fifo, locked;
  };

  RealTime(Machine<S>& machine, std::int64_t period, std::int64_t steps, int core)
      : machine(machine),
        period(period),
        steps(steps),
        core(core),
        bell(eventfd(0, EFD_NONBLOCK)) {}

  ~RealTime() {
    stop();
    close(bell);
  }

  // Begin at `tick`, the machine being at its state. Between `stop` and `start` the machine is free
  // for other use.
  void start(std::int64_t at) {
    stop();
    tick.store(at);
    stopping.store(false);
    thread = std::jthread([this] { run(); });
  }

  void stop() {
    stopping.store(true);
    if (!thread.joinable()) return;
    thread.join();
    machine.join_schedule();
  }

  void command(std::int64_t answered, const double* voltage) { commands.write(answered, voltage); }
  void power(bool on) { powered.store(on); }

  // The oldest snapshot not read yet; false if there is none. One reader.
  bool take(Snapshot<N>& out) {
    const std::int64_t r = read.load(std::memory_order_relaxed);
    if (r == written.load(std::memory_order_acquire)) return false;
    out = ring[r % kRing];
    read.store(r + 1, std::memory_order_release);
    return true;
  }

  // Becomes readable when there is a snapshot.
  int descriptor() const { return bell; }

  Status status() const {
    return {tick.load(),    lost_periods.load(), old_commands.load(), worst.load(), quantile(0.5),
            quantile(0.99), unread.load(),       fifo.load(),         locked.load()};
  }

  void clear_figures() {
    lost_periods.store(0);
    old_commands.store(0);
    worst.store(0);
    unread.store(0);
    for (auto& bin : bins) bin.store(0);
  }

 private:
  static constexpr int kRing = 16384;  // 16 s of backlog at 1 kHz: a busy machine may let us wait
  static constexpr int kBins = 4096;   // lateness by the microsecond, the last bin is "more"
  static constexpr std::int64_t kOldAfter = 2;  // servo periods

  void run() {
    become_real_time();
    std::int64_t due = now();
    std::int64_t answered = -1;
    double wanted[N] = {};
    const double nothing[N] = {};
    while (!stopping.load(std::memory_order_relaxed)) {
      due += period;
      sleep_until(due);
      const std::int64_t lateness = now() - due;
      note(lateness);
      if (lateness >= period) {
        const std::int64_t lost = lateness / period;
        lost_periods.fetch_add(lost);
        due += lost * period;
      }
      commands.read(answered, wanted);
      const std::int64_t k = tick.load(std::memory_order_relaxed);
      if (answered >= 0 && k - answered > kOldAfter) old_commands.fetch_add(1);
      const bool on = powered.load();
      const std::int64_t began = now();
      const int fault = machine.advance(on ? wanted : nothing, steps);
      const std::int64_t spent = now() - began;
      if (fault < 0) tick.store(k + 1);
      tell(fault < 0 ? k + 1 : k, answered, lateness, spent, fault, on ? wanted : nothing);
      if (fault >= 0) return;
    }
  }

  void tell(std::int64_t k, std::int64_t answered, std::int64_t lateness, std::int64_t spent,
            int fault, const double (&V)[N]) {
    const std::int64_t w = written.load(std::memory_order_relaxed);
    if (w - read.load(std::memory_order_acquire) == kRing) {
      unread.fetch_add(1);
      return;
    }
    Snapshot<N>& out = ring[w % kRing];
    const State<S>& x = machine.state();
    machine.report(out.i, out.tm, out.wm);
    out.tick = k;
    out.answered = answered;
    out.lateness = lateness;
    out.spent = spent;
    out.fault = fault;
    out.energy = machine.energy();
    machine.gear_torques(out.T);
    for (int j = 0; j < N; ++j) {
      out.q[j] = x.q[j];
      out.v[j] = x.v[j];
      out.V[j] = V[j];
    }
    written.store(w + 1, std::memory_order_release);
    const std::uint64_t one = 1;
    [[maybe_unused]] const auto rung = ::write(bell, &one, sizeof one);
  }

  // As far as the system permits; the status tells.
  void become_real_time() {
    sched_param priority = {};
    priority.sched_priority = 50;
    const bool permitted = pthread_setschedparam(pthread_self(), SCHED_FIFO, &priority) == 0;
    fifo.store(machine.join_schedule() && permitted);
#ifdef MCL_ONFAULT
    locked.store(mlockall(MCL_CURRENT | MCL_FUTURE | MCL_ONFAULT) == 0);
#endif
    if (core < 0) return;
    cpu_set_t cores;
    CPU_ZERO(&cores);
    CPU_SET(static_cast<unsigned>(core), &cores);
    pthread_setaffinity_np(pthread_self(), sizeof cores, &cores);
  }

  static std::int64_t now() {
    timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return t.tv_sec * 1'000'000'000LL + t.tv_nsec;
  }

  static void sleep_until(std::int64_t when) {
    const timespec t = {when / 1'000'000'000LL, when % 1'000'000'000LL};
    while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &t, nullptr) != 0) {
    }
  }

  void note(std::int64_t lateness) {
    if (lateness > worst.load(std::memory_order_relaxed)) worst.store(lateness);
    const std::int64_t bin = lateness / 1000;
    bins[bin < kBins ? bin : kBins - 1].fetch_add(1, std::memory_order_relaxed);
  }

  // Lateness that the share `part` of the wake-ups stayed below [ns], by the microsecond.
  std::int64_t quantile(double part) const {
    std::int64_t total = 0, below = 0;
    for (const auto& bin : bins) total += bin.load(std::memory_order_relaxed);
    for (int bin = 0; bin < kBins; ++bin) {
      below += bins[bin].load(std::memory_order_relaxed);
      if (static_cast<double>(below) >= part * static_cast<double>(total))
        return (bin + 1) * 1000LL;
    }
    return kBins * 1000LL;
  }

  Machine<S>& machine;
  const std::int64_t period;  // ns
  const std::int64_t steps;   // of the integrator in a period
  const int core;
  const int bell;
  Cell<N> commands;
  std::atomic<bool> powered = true, stopping = false;
  std::atomic<std::int64_t> tick = 0;
  std::atomic<std::int64_t> lost_periods = 0, old_commands = 0, worst = 0, unread = 0;
  std::atomic<std::int64_t> fifo = 0, locked = 0;
  std::atomic<std::uint32_t> bins[kBins] = {};
  alignas(64) std::atomic<std::int64_t> written = 0;
  alignas(64) std::atomic<std::int64_t> read = 0;
  Snapshot<N> ring[kRing] = {};
  std::jthread thread;  // last: it uses all of the above
};

}  // namespace arm
