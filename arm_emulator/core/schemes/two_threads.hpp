// The paper's two threads (Fig. 6): while the motor thread takes step k, the Newton-Euler thread
// works out the links' part at the angles of sample k, for step k + D. D is the depth of the
// exchange, 1 in the paper:
//
//   motor thread            step k - 1      | step k            | step k + 1
//                           uses links(k-2) | uses links(k-1)   | uses links(k)
//   Newton-Euler thread     links(k-1)      | links(k)          | links(k+1)
//
// Every step uses M and nle of D samples ago. With Exchange::lag they are those of that sample, as
// in the paper: an error of first order in the step. With Exchange::predict they are those of the
// state to which that sample's speeds and accelerations lead: the error is of second order.
//
// A sample goes to the other core, becomes the links' part there, returns and is used D + 1 steps
// later. A step therefore takes at least (both parts + both transfers) / (D + 1), and at least the
// longer part: a deeper exchange hides the transfers between the cores.
//
// A sample is sent as soon as its links have moved, and the links' part is received as late as a
// step can: the motors' work overlaps with the transfers.
//
// The threads are kept in step by two counters. The exchanged results depend on the step number
// alone, never on timing, so runs are equal to the last bit. Within a burst both threads spin;
// between bursts the Newton-Euler thread sleeps.
#pragma once

#include <pthread.h>
#include <sched.h>

#include <atomic>
#include <cstdint>
#include <new>
#include <thread>

#include "mechanics/links/links.hpp"
#include "mechanics/state.hpp"

namespace arm {

// Spin, then yield: on a single core the other thread needs it.
class Spin {
 public:
  void operator()() {
    if (++count_ % 256 == 0) std::this_thread::yield();
#ifdef __x86_64__
    else
      __builtin_ia32_pause();
#endif
  }

 private:
  int count_ = 0;
};

template <class S, class Stepper>
class TwoThreads {
 public:
  static constexpr int N = S::N, D = S::exchange_depth;
  using Dynamics = typename Links<S>::Dynamics;

  // `core`: of the Newton-Euler thread; -1, and on systems other than Linux: any.
  TwoThreads(double step, int core, const Numbers<S>& numbers)
      : h_(step), n_(numbers), stepper_(step, numbers), place_(core), newton_euler_([this] {
          evaluate_samples();
        }) {
    pin_to_core();
  }

  ~TwoThreads() {
    stopping_.store(true);
    notify_thread();
  }

  // Schedule the Newton-Euler thread as the caller is. It must not be less urgent than the thread
  // that waits for it. False if the system does not permit it.
  bool join_schedule() {
    int policy = SCHED_OTHER;
    sched_param priority = {};
    pthread_getschedparam(pthread_self(), &policy, &priority);
    return pthread_setschedparam(newton_euler_.native_handle(), policy, &priority) == 0;
  }

  // In a forked child, which has not got the Newton-Euler thread, between two bursts: begin one.
  void begin_thread() {
    // The handle is of the parent's thread and must not be joined.
    new (&newton_euler_) std::jthread([this] { evaluate_samples(); });
    pin_to_core();
  }

  // State at which a links' part is evaluated.
  struct Place {
    double q[N], v[N];
  };

  // Past values used by a step, beside the state: the speeds of one sample ago, and the links'
  // parts of D samples, the oldest first.
  struct Memory {
    double v[N];
    Place links[D];
    typename Stepper::Memory stepper;

    // number(x) for all of them, in a fixed order.
    template <class Number>
    void for_each_number(Number&& number) {
      for (int j = 0; j < N; ++j) {
        number(v[j]);
        for (Place& place : links) number(place.q[j]), number(place.v[j]);
      }
      stepper.for_each_number(number);
    }
  };

  // The numbers have changed; `restore` comes next.
  void update_tables() { stepper_.update_tables(); }

  // Begin at a state with no past.
  void reset(const State<S>& x) {
    for (int j = 0; j < N; ++j) {
      past_.v[j] = x.v[j];
      for (Place& place : past_.links) place.q[j] = x.q[j], place.v[j] = x.v[j];
    }
    stepper_.reset(x);
    past_.stepper = stepper_.memory();
    restore(past_);
  }

  Memory memory() const {
    Memory memory = past_;
    memory.stepper = stepper_.memory();
    return memory;
  }

  // Go back to a memory. The links' parts are computed again, by the same instructions.
  void restore(const Memory& memory) {
    past_ = memory;
    stepper_.restore(memory.stepper);
    for (int i = 0; i < D; ++i)
      evaluate(past_.links[i], buffers_[slot(published_.load() - D + i)].links);
  }

  // A burst of `count` steps is coming, one by one, from the state x.
  void begin_burst(std::int64_t count, const State<S>& x) {
    if (count == 0) return;
    target_.store(published_.load() + count);
    publish_sample(x);
    notify_thread();
  }

  // The burst is over, or broken off. The Newton-Euler thread goes to sleep.
  void end_burst() {
    target_.store(published_.load());
    wait_for_links(published_.load());
  }

  // From sample k to k + 1. Sample k is with the Newton-Euler thread already.
  ARM_INLINE void step(State<S>& x, const double (&u)[Stepper::row]) {
    for (int j = 0; j < N; ++j) past_.v[j] = x.v[j];
    for (int i = 1; i < D; ++i) past_.links[i - 1] = past_.links[i];
    past_.links[D - 1] = samples_[slot(newest_sample())];
    Dynamics links;
    stepper_.step(x, u, links, *this);
  }

  // The stepper asks for the links' part in step k: that of sample k - D.
  ARM_INLINE void receive_links(Dynamics& links) {
    const std::int64_t k = newest_sample();
    wait_for_links(k - D + 1);
    const LinkBuffer& buffer = buffers_[slot(k - D)];
    buffer.prefetch_lines();
    buffer.copy_to(links);
  }

  // The stepper has the links of sample k + 1, before it is done with the motors.
  ARM_INLINE void send_state(const State<S>& x) {
    if (published_.load(std::memory_order_relaxed) < target_.load(std::memory_order_relaxed))
      publish_sample(x);
  }

 private:
  // Samples and parcels on their way: those of the last D + 1 samples.
  static constexpr int slots = D + 1;
  static std::size_t slot(std::int64_t k) { return static_cast<std::size_t>(k + slots) % slots; }

  // The sample that was handed over last.
  std::int64_t newest_sample() const { return published_.load(std::memory_order_relaxed) - 1; }

  ARM_INLINE void publish_sample(const State<S>& x) {
    const std::int64_t k = published_.load(std::memory_order_relaxed);
    Sample& sample = samples_[slot(k)];
    // With a constant change of v per step: D steps ahead v has changed by D of them, and the sum
    // of the speeds that the links moved on with, by `sum`.
    const double ahead = S::exchange == Exchange::predict ? D : 0.0;
    constexpr double sum = 0.5 * (D - 1) + end_of_step;
    for (int j = 0; j < N; ++j) {
      const double change = x.v[j] - past_.v[j];
      sample.v[j] = x.v[j] + ahead * change;
      sample.q[j] = x.q[j] + ahead * h_ * (x.v[j] + sum * change);
    }
    published_.store(k + 1, std::memory_order_release);
  }

  static constexpr double end_of_step = S::Scheme::end_of_step;

  struct alignas(64) Sample : Place {
    ARM_INLINE void prefetch_lines() const { prefetch(this->q, this->v + N); }
  };

  // The links' part on its way between the cores. Only the numbers that have a meaning are read:
  // each cache line costs time on its way.
  struct LinkBuffer {
    Dynamics links;

    // Ask for the cache lines, all at once, before they are read one by one.
    ARM_INLINE void prefetch_lines() const {
      prefetch(links.nle, links.nle + N);
      for (int j = 0; j < N; ++j)
        prefetch(links.M.at[j] + first_lane<N>(j), links.M.at[j] + kPadded<N>);
    }
    ARM_INLINE void copy_to(Dynamics& to) const {
      for (int j = 0; j < N; ++j) {
        to.nle[j] = links.nle[j];
        for (int i = first_lane<N>(j); i < kPadded<N>; ++i) to.M.at[j][i] = links.M.at[j][i];
      }
    }
  };

  static ARM_INLINE void prefetch(const double* first, const double* end) {
    for (; first < end; first += 64 / sizeof(double)) __builtin_prefetch(first);
  }

  // Not inlined: the same bits whichever thread works.
  __attribute__((noinline)) void evaluate(const Place& at, Dynamics& result) const {
    Links<S>::compute_dynamics(n_, at.q, at.v, result);
  }

  void pin_to_core() {
#ifdef __linux__
    if (place_ < 0) return;
    cpu_set_t cores;
    CPU_ZERO(&cores);
    CPU_SET(static_cast<unsigned>(place_), &cores);
    pthread_setaffinity_np(newton_euler_.native_handle(), sizeof cores, &cores);
#endif
  }

  // The Newton-Euler thread.
  void evaluate_samples() {
    std::int64_t k = done_.load(),
                 here = k;  // samples that are worked on, that have been handed over
    for (;;) {
      const std::uint32_t signal = signal_.load();
      while (here > k || k < target_.load(std::memory_order_relaxed)) {
        Spin spin;
        while (here <= k) {
          here = published_.load(std::memory_order_acquire);
          if (here > k || k >= target_.load(std::memory_order_relaxed)) break;
          spin();
        }
        if (here <= k) break;
        LinkBuffer& buffer = buffers_[slot(k)];
        if (here > k + 1) samples_[slot(k + 1)].prefetch_lines();
        evaluate(samples_[slot(k)], buffer.links);
        done_.store(++k, std::memory_order_release);
      }
      if (stopping_.load()) return;
      signal_.wait(signal);
    }
  }

  // Until the links' parts of the first `k` samples are there.
  void wait_for_links(std::int64_t k) const {
    Spin spin;
    while (done_.load(std::memory_order_acquire) < k) spin();
  }

  void notify_thread() {
    signal_.fetch_add(1);
    signal_.notify_one();
  }

  double h_;
  const Numbers<S>& n_;
  Memory past_ = {};
  Sample samples_[slots] = {};
  LinkBuffer buffers_[slots] = {};
  // Each counter on a cache line of its own: who writes it does not disturb who reads the other.
  alignas(64) std::atomic<std::int64_t> published_ =
      0;                                            // samples handed to the Newton-Euler thread
  alignas(64) std::atomic<std::int64_t> done_ = 0;  // links' parts that are ready
  alignas(64) std::atomic<std::int64_t> target_ =
      0;                                   // samples that the burst will have handed over
  std::atomic<std::uint32_t> signal_ = 0;  // changes to wake the sleeper
  std::atomic<bool> stopping_ = false;
  alignas(64) Stepper stepper_;
  int place_;                  // core of the thread; -1: any
  std::jthread newton_euler_;  // last: it uses all of the above
};

}  // namespace arm
