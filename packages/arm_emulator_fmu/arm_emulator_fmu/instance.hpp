// One instance of the unit: a machine, the values of its variables, and its place in the standard's
// life cycle. The functions that importers call are in fmi3.cpp and fmi2.cpp.
//
// The machine goes from tick to tick of its drives, whatever the steps of the importer: inputs of a
// tick are held until the next one, and outputs are those of the tick before. So no output depends
// on an input of the same tick.
//
// Included after the table of variables (unit.py). The machine is a source of its own.
#pragma once

#include <atomic>
#include <cstdarg>
#include <cstdint>
#include <cstring>
#include <memory>
#include <new>
#include <utility>

#include "data.hpp"
#include "kept_states.hpp"
#include "log.hpp"
#include "machine.hpp"
#include "numerics/finite.hpp"
#include "variable.hpp"

namespace fmu {

// Bits, so that a call can name all modes in which it is allowed.
enum Mode : std::uint32_t { kInstantiated = 1, kInitialization = 2, kStep = 4, kTerminated = 8 };
constexpr std::uint32_t kBeforeStart = kInstantiated | kInitialization;
constexpr std::uint32_t kSettable = kBeforeStart | kStep;
constexpr std::uint32_t kAnyMode = kSettable | kTerminated;

constexpr int kVariableCount = sizeof kVariables / sizeof *kVariables;
constexpr double kLargestTicks = 1e15;   // of one step
constexpr double kDue = 1e-6 * kPeriod;  // s, by which sums of steps may miss a tick by rounding

// Callback of an importer at each tick within a step: whether it shall end at `*until` [s].
using Watch = std::function<bool(double time, double* until)>;

class Instance {
 public:
  Instance(const char* name, bool logging, Log log, Watch watch = {})
      : logger_(name, logging, std::move(log)), watch_(std::move(watch)) {}
  Instance(const Instance&) = delete;
  Instance& operator=(const Instance&) = delete;

  // Make the machine; false if that fails.
  bool make() {
    if (!machine_.make()) return false;
    reset_machine();
    return true;
  }

  // ------------------------------------------------------------------------------------- logging

  // Return the status of a call; unless it is success, the reason is reported. An error
  // ends the simulation; a reset or a stored state restarts it.
  Status report(Status status, const char* format, ...) __attribute__((format(printf, 3, 4))) {
    if (status == kError) values_.mode = kTerminated;
    va_list arguments;
    va_start(arguments, format);
    logger_.write(status, format, arguments);
    va_end(arguments);
    return status;
  }

  // Switch categories on or off; all of them if `count` is 0.
  Status set_logging(bool on, std::size_t count, const char* const* categories) {
    if (count && !categories) return report(kError, "categories must be given, got none");
    if (const char* unknown = logger_.set(on, count, categories))
      return report(kError, "log category must be one of modelDescription.xml, got %.100s",
                    unknown);
    return kOk;
  }

  // --------------------------------------------------------------------------------- its life

  // Whether `call` may be made now; if not, it is an error.
  bool allows(std::uint32_t modes, const char* call) {
    if (values_.mode & modes) return true;
    const char* now = values_.mode == kInstantiated     ? "instantiation"
                      : values_.mode == kInitialization ? "initialization mode"
                      : values_.mode == kStep           ? "step mode"
                                                        : "termination";
    report(kError, "%s must not be called after %s", call, now);
    return false;
  }

  Status set_times(double start, bool has_stop, double stop) {
    if (!arm::is_finite(start)) return report(kError, "start time must be finite [s]");
    if (has_stop && (!arm::is_finite(stop) || stop < start))
      return report(kError, "stop time must be finite and not before the start [s]");
    values_.start = values_.clock = start;
    values_.has_stop = has_stop;
    values_.stop = has_stop ? stop : 0.0;
    return kOk;
  }
  Status enter_initialization() {
    values_.mode = kInitialization;
    return kOk;
  }
  Status exit_initialization() {
    put_at_start();
    values_.mode = kStep;
    return report(kOk, "the machine is at its start");
  }
  // End a step that another thread runs, at its next tick.
  Status terminate() {
    if (stepping_)
      ending_ = kTerminates;
    else
      values_.mode = kTerminated;
    return kOk;
  }
  Status cancel_step() {
    if (!stepping_) return report(kError, "a step must be under way to be cancelled");
    ending_ = kCancels;
    return kOk;
  }
  Status reset() {
    if (stepping_) return busy();
    reset_machine();
    return report(kOk, "reset");
  }

  double time() const {
    const double tick = values_.start + static_cast<double>(values_.ticks) * kPeriod;
    const double rounding = 4.0 * 0x1p-52 * (__builtin_fabs(tick) + kPeriod);
    return __builtin_fabs(values_.since_tick) > rounding ? tick + values_.since_tick : tick;
  }
  // Whether the step that was taken last ended before its time, as its importer asked.
  bool returned_early() const { return early_; }

  // Go from `from` by `step` [s].
  Status do_step(double from, double step) {
    early_ = false;
    if (stepping_) return busy();
    if (!arm::is_finite(from) || !arm::is_finite(step) || step <= 0.0)
      return report(kError, "communication step must be finite and > 0 s, got %g s at %g s", step,
                    from);
    const double near = 0.25 * (step < kPeriod ? step : kPeriod);
    if (__builtin_fabs(from - values_.clock) > near)
      return report(kError,
                    "communication point must be %.17g s, where the machine is, got %.17g s",
                    values_.clock, from);
    if (step > kLargestTicks * kPeriod)
      return report(kDiscard, "communication step must be at most %g s, got %g s",
                    kLargestTicks * kPeriod, step);
    if (values_.has_stop && from + step > values_.stop + near)
      return report(kError, "communication step must end at %.17g s, the stop time, got %.17g s",
                    values_.stop, from + step);
    stepping_ = true;
    const Status status = advance(from, step);
    stepping_ = false;
    const int ending = ending_.exchange(kGoesOn);
    if (ending == kTerminates) values_.mode = kTerminated;
    return status;
  }

  // -------------------------------------------------------------------------------- variables

  // Whether `count` references are of variables of this type with so many values in all; if not,
  // it is an error. FMI 2 has no 64-bit integers and takes them as `other`.
  bool match(const char* call, const unsigned* references, std::size_t count, Type type, Type other,
             const void* values, std::size_t size) {
    std::size_t all = 0;
    if (count && !references) return report(kError, "%s: references must be given", call), false;
    for (std::size_t k = 0; k < count; ++k) {
      if (references[k] >= static_cast<unsigned>(kVariableCount))
        return report(kError, "%s: value reference must be below %d, got %u", call, kVariableCount,
                      references[k]),
               false;
      const Variable& one = kVariables[references[k]];
      if (one.type != type && one.type != other)
        return report(kError, "%s: variable %u must be of the call's type", call, references[k]),
               false;
      all += static_cast<std::size_t>(one.count);
    }
    if (all != size || (all && !values))
      return report(kError, "%s: there must be %zu values, got %zu", call, all, values ? size : 0),
             false;
    return true;
  }

  // Whether these variables may be set now; if not, it is an error.
  bool settable(const char* call, const unsigned* references, std::size_t count) {
    for (std::size_t k = 0; k < count; ++k) {
      const Role role = kVariables[references[k]].role;
      const bool now = role == Role::input || role == Role::tunable ||
                       (role == Role::fixed && values_.mode & kBeforeStart);
      if (!now)
        return report(kError, "%s: variable %u cannot be set now", call, references[k]), false;
    }
    return true;
  }

  // Values of variables, in a row; see `match`.
  template <class Value>
  Status get(const char* call, const unsigned* references, std::size_t count, Type type, Type other,
             Value* values, std::size_t size) {
    if (!match(call, references, count, type, other, values, size)) return kError;
    look(references, count);
    for (std::size_t r = 0; r < count; ++r) {
      const Variable& one = kVariables[references[r]];
      for (int k = 0; k < one.count; ++k)
        *values++ = type == Type::boolean ? Value(value_at<bool>(data_, one.place, k))
                                          : value_at<Value>(data_, one.place, k);
    }
    return kOk;
  }
  // Whether values may be set; all of them is done for integers, which are outputs.
  Status take(const char* call, const unsigned* references, std::size_t count, Type type,
              const void* values, std::size_t size) {
    return match(call, references, count, type, type, values, size) &&
                   settable(call, references, count)
               ? kOk
               : kError;
  }
  // `Flag`: in which 0 is false.
  template <class Flag>
  Status set_flags(const char* call, const unsigned* references, std::size_t count,
                   const Flag* values, std::size_t size) {
    if (take(call, references, count, Type::boolean, values, size) != kOk) return kError;
    for (std::size_t r = 0; r < count; ++r)
      for (int k = 0; k < kVariables[references[r]].count; ++k)
        *place_in(data_, kVariables[references[r]].place, k) = *values++ != 0;
    if (count && values_.mode & kBeforeStart) values_.moved = true;
    return kOk;
  }
  // Calls of a type that no variable has.
  Status none(const char* call, std::size_t count) {
    return count ? report(kError, "%s: no variable is of this type", call) : kOk;
  }
  // All values or none are taken.
  Status set_numbers(const char* call, const unsigned* references, std::size_t count,
                     const double* values, std::size_t size) {
    if (take(call, references, count, Type::float64, values, size) != kOk) return kError;
    const double* value = values;
    for (std::size_t r = 0; r < count; ++r)
      for (int k = 0; k < kVariables[references[r]].count; ++k)
        if (const char* rule = machine_.find_obstacle(kVariables[references[r]], k, *value++)) {
          if (const char* joint = machine_.commanded(kVariables[references[r]], k))
            return report(kDiscard, "%s: command of %s must %s, got %g", call, joint, rule,
                          value[-1]);
          return report(kDiscard, "%s: value %d of variable %u must %s, got %g", call, k,
                        references[r], rule, value[-1]);
        }
    for (std::size_t r = 0; r < count; ++r) {
      const Variable& one = kVariables[references[r]];
      for (int k = 0; k < one.count; ++k)
        std::memcpy(place_in(data_, one.place, k), values++, sizeof *values);
      if (one.role == Role::tunable) {
        values_.retuned = true;
        if (!values_.underway) take_parameters();
      }
      if (one.role != Role::input && !values_.underway) {
        reported_ = truth_reported_ = false;
        if (values_.mode & kBeforeStart) values_.moved = true;
      }
    }
    return kOk;
  }
  // Update the data that these variables report.
  void look(const unsigned* references, std::size_t count) {
    put_at_start();
    bool truth = false;
    for (std::size_t k = 0; k < count; ++k) truth |= kVariables[references[k]].truth;
    if (!reported_) machine_.measure();
    reported_ = true;
    if (truth && !truth_reported_) machine_.measure_truth();
    truth_reported_ = truth_reported_ || truth;
    data_.shown.time = time();
  }

  // ------------------------------------------------------------------------------ whole states

  // Keep the state in `*state`, which is made if it is null.
  Status keep(void** state) {
    if (!state) return report(kError, "state must have a place, got none");
    if (*state && !states_.is_known(*state)) return refuse_unknown_state();
    if (!*state) *state = states_.make();
    put_at_start();
    unsigned char* bytes = states_.find_content(*state);
    std::memcpy(bytes, &values_, sizeof values_);
    machine_.save(bytes + sizeof values_);
    states_.compute_seal(*state, machine_.fingerprint());
    return kOk;
  }
  Status restore_state(void* state) {
    if (stepping_) return busy();
    if (!states_.is_known(state)) return refuse_unknown_state();
    const unsigned char* bytes = states_.find_content(state);
    if (!machine_.restore(bytes + sizeof values_)) return refused(kError);
    std::memcpy(&values_, bytes, sizeof values_);
    reported_ = truth_reported_ = false;
    return report(kOk, "went back to %.17g s", time());
  }
  Status forget(void** state) {
    if (!state || !*state || states_.forget(state)) return kOk;
    return refuse_unknown_state();
  }
  Status write_state(void* state, void* bytes, std::size_t size) {
    if (!states_.is_known(state)) return refuse_unknown_state();
    if (size != states_.size() || !bytes) return refuse_size(bytes ? size : 0);
    std::memcpy(bytes, states_.count_bytes(state), size);
    return kOk;
  }
  Status read_state(const void* bytes, std::size_t size, void** state) {
    if (!state || (*state && !states_.is_known(*state))) return refuse_unknown_state();
    if (size != states_.size() || !bytes) return refuse_size(bytes ? size : 0);
    if (const char* rule = states_.find_obstacle(bytes, machine_.fingerprint()))
      return report(kError, "serialized state must %s", rule);
    if (!*state) *state = states_.make();
    std::memcpy(states_.count_bytes(*state), bytes, size);
    return kOk;
  }
  Status size_of(void* state, std::size_t* size) {
    if (!states_.is_known(state)) return refuse_unknown_state();
    if (!size) return report(kError, "size must have a place, got none");
    *size = states_.size();
    return kOk;
  }

 private:
  // As just instantiated: everything at its start value.
  void reset_machine() {
    std::memset(static_cast<void*>(&values_), 0, sizeof values_);  // states have no chance bytes
    values_.mode = kInstantiated;
    values_.moved = true;
    values_.now.power = 1;
    for (int j = 0; j < N; ++j) {
      values_.now.enable[j] = 1;
      values_.start_q[j] = kStartQ[j];
    }
    for (int k = 0; k < kParameters; ++k) values_.parameter[k] = kParameterStart[k];
    take_parameters();
  }
  void take_parameters() {
    machine_.set_parameters(values_.parameter);
    values_.retuned = false;
  }

  // Request to a running step, by another thread or by the importer within the step.
  enum Ending { kGoesOn, kCancels, kTerminates };
  Status busy() { return report(kError, "no call but gets and an end may come during a step"); }

  // Advance by `step` from one tick to the next, as far as they are due.
  Status advance(double from, double step) {
    double goal = values_.since_tick + step, left = goal;  // s, from the last tick
    for (double done = 1.0;; ++done) {
      if (!values_.underway) begin_period();
      if (left < kPeriod - kDue) break;
      if (const Status status = end_period(); status != kOk) return status;
      left = goal - done * kPeriod;
      values_.since_tick = 0.0;
      if (left <= kDue) break;
      if (ending_ != kGoesOn) {
        values_.clock = time();
        return report(kDiscard, "the step ended at %.17g s, as it was asked to", time());
      }
      double until = time();
      if (watch_ && watch_(time(), &until) && until < time() + left) {
        early_ = true;
        left = until > time() ? until - time() : 0.0;
        goal = done * kPeriod + left;
        if (left <= kDue) break;
      }
    }
    values_.since_tick = left;
    values_.clock = early_ ? time() : from + step;
    return kOk;
  }
  void begin_period() {
    if (values_.retuned) take_parameters();
    std::memcpy(&values_.held, &values_.now, sizeof values_.held);
    values_.underway = true;
  }
  Status end_period() {
    reported_ = truth_reported_ = false;
    const int result = machine_.exchange(values_.held);
    if (result == ARM_REFUSED) return refused(kError);
    if (result == ARM_DIVERGED) return diverged();
    ++values_.ticks;
    values_.underway = false;
    return kOk;
  }
  void put_at_start() {
    if (!values_.moved) return;
    machine_.put_at(values_.now.power, values_.start_q, values_.start_v);
    values_.moved = false;
    reported_ = truth_reported_ = false;
  }

  Status refused(Status status) {
    const arm_refusal why = machine_.why();
    const char* joint = machine_.name_of(why.joint);
    return report(status, "%s%s%s must %s, got %g", why.quantity, joint ? " of " : "",
                  joint ? joint : "", why.rule, why.got);
  }
  Status diverged() {
    const arm_truth truth = machine_.clock();
    const char* joint = machine_.name_of(truth.fault);
    return report(kError,
                  "joint %s diverged after %.17g s; the machine stays at its last sound state",
                  joint ? joint : "?", values_.start + truth.time);
  }

  Status refuse_unknown_state() {
    return report(kError, "state must be one that this instance has kept");
  }
  Status refuse_size(std::size_t size) {
    return report(kError, "serialized state must have %zu bytes, got %zu", states_.size(), size);
  }

  Logger logger_;
  Watch watch_;
  std::atomic<bool> stepping_ = false;
  std::atomic<int> ending_ = kGoesOn;
  bool early_ = false;
  Data data_ = {};
  Values& values_ = data_.values;
  KeptStates states_{sizeof(Values) + Machine::saved_size()};

  // Whether the newest outputs of the machine are in the data.
  bool reported_ = false, truth_reported_ = false;
  Machine machine_{data_};
};

// A new instance; null if memory is short or the machine cannot be made.
template <class... Given>
Instance* make_instance(Given&&... given) {
  try {
    auto one = std::make_unique<Instance>(std::forward<Given>(given)...);
    return one->make() ? one.release() : nullptr;
  } catch (const std::bad_alloc&) {
    return nullptr;
  }
}

}  // namespace fmu
