// The functions of FMI 3.0 for co-simulation, over one machine per instance (instance.hpp).
#include "fmi3.h"

#include "instance.hpp"

namespace {

using fmu::Instance;
using fmu::Type;

Instance* of(fmi3Instance instance) { return static_cast<Instance*>(instance); }

fmi3Status as_fmi3(fmu::Status status) { return static_cast<fmi3Status>(status); }

// Return the result of `call` if the instance is in one of these modes.
template <class Call>
fmi3Status in(std::uint32_t modes, fmi3Instance instance, const char* name, Call&& call) {
  if (!instance || !of(instance)->allows(modes, name)) return fmi3Error;
  try {
    return as_fmi3(call(*of(instance)));
  } catch (const std::bad_alloc&) {
    return as_fmi3(of(instance)->report(fmu::kError, "%s: there is no memory left", name));
  }
}

template <class Call>
fmi3Status get(fmi3Instance instance, const char* name, const fmi3ValueReference* references,
               std::size_t count, Type type, const void* values, std::size_t size, Call&& each) {
  return in(fmu::kAnyMode, instance, name, [&](Instance& one) {
    if (!one.match(name, references, count, type, type, values, size)) return fmu::kError;
    one.look(references, count);
    for (std::size_t r = 0; r < count; ++r) {
      const fmu::Variable& variable = fmu::kVariables[references[r]];
      for (int k = 0; k < variable.count; ++k) each(one, variable, k);
    }
    return fmu::kOk;
  });
}

template <class Call>
fmi3Status set(fmi3Instance instance, const char* name, const fmi3ValueReference* references,
               std::size_t count, Type type, const void* values, std::size_t size, Call&& call) {
  return in(fmu::kSettable, instance, name, [&](Instance& one) {
    if (!one.match(name, references, count, type, type, values, size) ||
        !one.settable(name, references, count))
      return fmu::kError;
    return call(one);
  });
}

// Of types that no variable has.
fmi3Status none_of_this_type(fmi3Instance instance, const char* name, std::size_t count) {
  return in(fmu::kAnyMode, instance, name, [&](Instance& one) {
    return count ? one.report(fmu::kError, "%s: no variable is of this type", name) : fmu::kOk;
  });
}

// Functions that modelDescription.xml declares as missing.
fmi3Status not_there(fmi3Instance instance, const char* name) {
  if (!instance) return fmi3Error;
  return as_fmi3(of(instance)->report(fmu::kError, "%s is not supported", name));
}

void log_to(const fmu::Log& log, fmu::Status status, const char* category, const char* text) {
  reinterpret_cast<fmi3LogMessageCallback>(log.function)(log.environment, as_fmi3(status), category,
                                                         text);
}

fmu::Log log_of(fmi3LogMessageCallback function, fmi3InstanceEnvironment environment) {
  return {log_to, reinterpret_cast<void (*)()>(function), environment, ""};
}

// At a tick: the importer may read variables, and request an early return.
bool watch_at(const fmu::Watch& watch, double time, double* until) {
  bool requested = false;
  reinterpret_cast<fmi3IntermediateUpdateCallback>(watch.function)(
      watch.environment, time, false, true, true, watch.may_return_early, &requested, until);
  return requested && watch.may_return_early;
}

bool are_outputs(const fmi3ValueReference* references, std::size_t count) {
  for (std::size_t k = 0; k < count; ++k)
    if (!references || references[k] >= static_cast<unsigned>(fmu::kVariableCount) ||
        fmu::kVariables[references[k]].role != fmu::Role::output)
      return false;
  return true;
}

fmi3Instance refuse(fmi3LogMessageCallback function, fmi3InstanceEnvironment environment,
                    const char* text) {
  if (function) function(environment, fmi3Error, fmu::kCategoryNames[fmu::kStatusError], text);
  return nullptr;
}

}  // namespace

// ----------------------------------------------------------------------------- life and logging

const char* fmi3GetVersion(void) { return "3.0"; }

fmi3Status fmi3SetDebugLogging(fmi3Instance instance, fmi3Boolean on, size_t count,
                               const fmi3String categories[]) {
  return in(fmu::kAnyMode, instance, "fmi3SetDebugLogging",
            [&](Instance& one) { return one.set_logging(on, count, categories); });
}

fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String, fmi3Boolean,
                                         fmi3Boolean logging, fmi3Boolean event_mode,
                                         fmi3Boolean early_return,
                                         const fmi3ValueReference intermediate[],
                                         size_t intermediates, fmi3InstanceEnvironment environment,
                                         fmi3LogMessageCallback log,
                                         fmi3IntermediateUpdateCallback update) {
  if (!name || !*name) return refuse(log, environment, "instance name must be given");
  if (!token || std::strcmp(token, fmu::kToken) != 0)
    return refuse(log, environment, "instantiation token must be that of modelDescription.xml");
  if (event_mode) return refuse(log, environment, "event mode is not supported");
  if (!are_outputs(intermediate, intermediates))
    return refuse(log, environment, "intermediate variables must be outputs");
  const fmu::Watch watch = {watch_at, reinterpret_cast<void (*)()>(update), environment,
                            early_return};
  if (Instance* one = fmu::make_instance(name, logging, log_of(log, environment), watch))
    return one;
  return refuse(log, environment, "the machine cannot be made");
}
fmi3Instance fmi3InstantiateModelExchange(fmi3String, fmi3String, fmi3String, fmi3Boolean,
                                          fmi3Boolean, fmi3InstanceEnvironment environment,
                                          fmi3LogMessageCallback log) {
  return refuse(log, environment, "model exchange is not supported, co-simulation is");
}
fmi3Instance fmi3InstantiateScheduledExecution(fmi3String, fmi3String, fmi3String, fmi3Boolean,
                                               fmi3Boolean, fmi3InstanceEnvironment environment,
                                               fmi3LogMessageCallback log, fmi3ClockUpdateCallback,
                                               fmi3LockPreemptionCallback,
                                               fmi3UnlockPreemptionCallback) {
  return refuse(log, environment, "scheduled execution is not supported, co-simulation is");
}
void fmi3FreeInstance(fmi3Instance instance) { delete of(instance); }

fmi3Status fmi3EnterInitializationMode(fmi3Instance instance, fmi3Boolean, fmi3Float64,
                                       fmi3Float64 start, fmi3Boolean has_stop, fmi3Float64 stop) {
  return in(fmu::kInstantiated, instance, "fmi3EnterInitializationMode", [&](Instance& one) {
    const fmu::Status status = one.set_times(start, has_stop, stop);
    return status == fmu::kOk ? one.enter_initialization() : status;
  });
}
fmi3Status fmi3ExitInitializationMode(fmi3Instance instance) {
  return in(fmu::kInitialization, instance, "fmi3ExitInitializationMode",
            [](Instance& one) { return one.exit_initialization(); });
}
fmi3Status fmi3Terminate(fmi3Instance instance) {
  return in(fmu::kStep, instance, "fmi3Terminate", [](Instance& one) { return one.terminate(); });
}
fmi3Status fmi3Reset(fmi3Instance instance) {
  return in(fmu::kAnyMode, instance, "fmi3Reset", [](Instance& one) { return one.reset(); });
}

fmi3Status fmi3DoStep(fmi3Instance instance, fmi3Float64 time, fmi3Float64 step, fmi3Boolean,
                      fmi3Boolean* event_handling_needed, fmi3Boolean* terminate,
                      fmi3Boolean* early_return, fmi3Float64* last_successful_time) {
  for (fmi3Boolean* flag : {event_handling_needed, terminate, early_return})
    if (flag) *flag = false;
  const fmi3Status status = in(fmu::kStep, instance, "fmi3DoStep",
                               [&](Instance& one) { return one.do_step(time, step); });
  if (instance && last_successful_time) *last_successful_time = of(instance)->time();
  if (instance && early_return) *early_return = of(instance)->returned_early();
  return status;
}

// ---------------------------------------------------------------------------------- variables

fmi3Status fmi3GetFloat64(fmi3Instance instance, const fmi3ValueReference references[],
                          size_t count, fmi3Float64 values[], size_t size) {
  return get(instance, "fmi3GetFloat64", references, count, Type::float64, values, size,
             [&](Instance& one, auto& of, int k) { *values++ = one.value<double>(of, k); });
}
fmi3Status fmi3GetInt64(fmi3Instance instance, const fmi3ValueReference references[], size_t count,
                        fmi3Int64 values[], size_t size) {
  return get(instance, "fmi3GetInt64", references, count, Type::int64, values, size,
             [&](Instance& one, auto& of, int k) { *values++ = one.value<std::int64_t>(of, k); });
}
fmi3Status fmi3GetInt32(fmi3Instance instance, const fmi3ValueReference references[], size_t count,
                        fmi3Int32 values[], size_t size) {
  return get(instance, "fmi3GetInt32", references, count, Type::int32, values, size,
             [&](Instance& one, auto& of, int k) { *values++ = one.value<std::int32_t>(of, k); });
}
fmi3Status fmi3GetBoolean(fmi3Instance instance, const fmi3ValueReference references[],
                          size_t count, fmi3Boolean values[], size_t size) {
  return get(instance, "fmi3GetBoolean", references, count, Type::boolean, values, size,
             [&](Instance& one, auto& of, int k) { *values++ = one.value<bool>(of, k); });
}
fmi3Status fmi3SetFloat64(fmi3Instance instance, const fmi3ValueReference references[],
                          size_t count, const fmi3Float64 values[], size_t size) {
  return set(
      instance, "fmi3SetFloat64", references, count, Type::float64, values, size,
      [&](Instance& one) { return one.set_numbers("fmi3SetFloat64", references, count, values); });
}
fmi3Status fmi3SetBoolean(fmi3Instance instance, const fmi3ValueReference references[],
                          size_t count, const fmi3Boolean values[], size_t size) {
  return set(instance, "fmi3SetBoolean", references, count, Type::boolean, values, size,
             [&](Instance& one) {
               // Not every importer writes 0 or 1, and a bool must be no other.
               const auto* byte = reinterpret_cast<const unsigned char*>(values);
               for (size_t r = 0; r < count; ++r)
                 for (int k = 0; k < fmu::kVariables[references[r]].count; ++k)
                   one.set_flag(references[r], k, *byte++ != 0);
               return fmu::kOk;
             });
}
// Integers are outputs.
fmi3Status fmi3SetInt64(fmi3Instance instance, const fmi3ValueReference references[], size_t count,
                        const fmi3Int64 values[], size_t size) {
  return set(instance, "fmi3SetInt64", references, count, Type::int64, values, size,
             [](Instance&) { return fmu::kOk; });
}
fmi3Status fmi3SetInt32(fmi3Instance instance, const fmi3ValueReference references[], size_t count,
                        const fmi3Int32 values[], size_t size) {
  return set(instance, "fmi3SetInt32", references, count, Type::int32, values, size,
             [](Instance&) { return fmu::kOk; });
}

#define NONE_OF_TYPE(Type_)                                                                  \
  fmi3Status fmi3Get##Type_(fmi3Instance instance, const fmi3ValueReference[], size_t count, \
                            fmi3##Type_[], size_t) {                                         \
    return none_of_this_type(instance, "fmi3Get" #Type_, count);                             \
  }                                                                                          \
  fmi3Status fmi3Set##Type_(fmi3Instance instance, const fmi3ValueReference[], size_t count, \
                            const fmi3##Type_[], size_t) {                                   \
    return none_of_this_type(instance, "fmi3Set" #Type_, count);                             \
  }
NONE_OF_TYPE(Float32)
NONE_OF_TYPE(Int8)
NONE_OF_TYPE(UInt8)
NONE_OF_TYPE(Int16)
NONE_OF_TYPE(UInt16)
NONE_OF_TYPE(UInt32)
NONE_OF_TYPE(UInt64)
NONE_OF_TYPE(String)

fmi3Status fmi3GetBinary(fmi3Instance instance, const fmi3ValueReference[], size_t count, size_t[],
                         fmi3Binary[], size_t) {
  return none_of_this_type(instance, "fmi3GetBinary", count);
}
fmi3Status fmi3SetBinary(fmi3Instance instance, const fmi3ValueReference[], size_t count,
                         const size_t[], const fmi3Binary[], size_t) {
  return none_of_this_type(instance, "fmi3SetBinary", count);
}
fmi3Status fmi3GetClock(fmi3Instance instance, const fmi3ValueReference[], size_t count,
                        fmi3Clock[]) {
  return none_of_this_type(instance, "fmi3GetClock", count);
}
fmi3Status fmi3SetClock(fmi3Instance instance, const fmi3ValueReference[], size_t count,
                        const fmi3Clock[]) {
  return none_of_this_type(instance, "fmi3SetClock", count);
}

// -------------------------------------------------------------------------------- whole states

fmi3Status fmi3GetFMUState(fmi3Instance instance, fmi3FMUState* state) {
  return in(fmu::kAnyMode, instance, "fmi3GetFMUState",
            [&](Instance& one) { return one.keep(state); });
}
fmi3Status fmi3SetFMUState(fmi3Instance instance, fmi3FMUState state) {
  return in(fmu::kAnyMode, instance, "fmi3SetFMUState",
            [&](Instance& one) { return one.go_back_to(state); });
}
fmi3Status fmi3FreeFMUState(fmi3Instance instance, fmi3FMUState* state) {
  return in(fmu::kAnyMode, instance, "fmi3FreeFMUState",
            [&](Instance& one) { return one.forget(state); });
}
fmi3Status fmi3SerializedFMUStateSize(fmi3Instance instance, fmi3FMUState state, size_t* size) {
  return in(fmu::kAnyMode, instance, "fmi3SerializedFMUStateSize",
            [&](Instance& one) { return one.size_of(state, size); });
}
fmi3Status fmi3SerializeFMUState(fmi3Instance instance, fmi3FMUState state, fmi3Byte bytes[],
                                 size_t size) {
  return in(fmu::kAnyMode, instance, "fmi3SerializeFMUState",
            [&](Instance& one) { return one.write_state(state, bytes, size); });
}
fmi3Status fmi3DeserializeFMUState(fmi3Instance instance, const fmi3Byte bytes[], size_t size,
                                   fmi3FMUState* state) {
  return in(fmu::kAnyMode, instance, "fmi3DeserializeFMUState",
            [&](Instance& one) { return one.read_state(bytes, size, state); });
}

// ------------------------------------------------------------------------------- not supported

#define NOT_THERE(name, ...)                                          \
  fmi3Status name(fmi3Instance instance __VA_OPT__(, ) __VA_ARGS__) { \
    return not_there(instance, #name);                                \
  }
#define REFERENCES const fmi3ValueReference[], size_t
NOT_THERE(fmi3EnterEventMode)
NOT_THERE(fmi3EnterStepMode)
NOT_THERE(fmi3EnterConfigurationMode)
NOT_THERE(fmi3ExitConfigurationMode)
NOT_THERE(fmi3EvaluateDiscreteStates)
NOT_THERE(fmi3UpdateDiscreteStates, fmi3Boolean*, fmi3Boolean*, fmi3Boolean*, fmi3Boolean*,
          fmi3Boolean*, fmi3Float64*)
NOT_THERE(fmi3GetNumberOfVariableDependencies, fmi3ValueReference, size_t*)
NOT_THERE(fmi3GetVariableDependencies, fmi3ValueReference, size_t[], fmi3ValueReference[], size_t[],
          fmi3DependencyKind[], size_t)
NOT_THERE(fmi3GetDirectionalDerivative, REFERENCES, REFERENCES, const fmi3Float64[], size_t,
          fmi3Float64[], size_t)
NOT_THERE(fmi3GetAdjointDerivative, REFERENCES, REFERENCES, const fmi3Float64[], size_t,
          fmi3Float64[], size_t)
NOT_THERE(fmi3GetOutputDerivatives, REFERENCES, const fmi3Int32[], fmi3Float64[], size_t)
NOT_THERE(fmi3GetIntervalDecimal, REFERENCES, fmi3Float64[], fmi3IntervalQualifier[])
NOT_THERE(fmi3GetIntervalFraction, REFERENCES, fmi3UInt64[], fmi3UInt64[], fmi3IntervalQualifier[])
NOT_THERE(fmi3GetShiftDecimal, REFERENCES, fmi3Float64[])
NOT_THERE(fmi3GetShiftFraction, REFERENCES, fmi3UInt64[], fmi3UInt64[])
NOT_THERE(fmi3SetIntervalDecimal, REFERENCES, const fmi3Float64[])
NOT_THERE(fmi3SetIntervalFraction, REFERENCES, const fmi3UInt64[], const fmi3UInt64[])
NOT_THERE(fmi3SetShiftDecimal, REFERENCES, const fmi3Float64[])
NOT_THERE(fmi3SetShiftFraction, REFERENCES, const fmi3UInt64[], const fmi3UInt64[])
NOT_THERE(fmi3EnterContinuousTimeMode)
NOT_THERE(fmi3CompletedIntegratorStep, fmi3Boolean, fmi3Boolean*, fmi3Boolean*)
NOT_THERE(fmi3SetTime, fmi3Float64)
NOT_THERE(fmi3SetContinuousStates, const fmi3Float64[], size_t)
NOT_THERE(fmi3GetContinuousStateDerivatives, fmi3Float64[], size_t)
NOT_THERE(fmi3GetEventIndicators, fmi3Float64[], size_t)
NOT_THERE(fmi3GetContinuousStates, fmi3Float64[], size_t)
NOT_THERE(fmi3GetNominalsOfContinuousStates, fmi3Float64[], size_t)
NOT_THERE(fmi3GetNumberOfEventIndicators, size_t*)
NOT_THERE(fmi3GetNumberOfContinuousStates, size_t*)
NOT_THERE(fmi3ActivateModelPartition, fmi3ValueReference, fmi3Float64)
