// The functions of FMI 3.0 for co-simulation, over one machine per instance (instance.hpp).
#include "fmi3.h"

using FmiStatus = fmi3Status;
using FmiInstance = fmi3Instance;
#include "calls.hpp"

namespace {

using fmu::Instance;

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

FMI_CALL(fmi3SetDebugLogging, fmu::kAnyMode, set_logging(on, count, categories), fmi3Boolean on,
         size_t count, const fmi3String categories[])

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
  const auto send = [=](const char*, fmu::Status status, const char* category, const char* text) {
    if (log) log(environment, fmu::to_fmi_status(status), category, text);
  };
  // At a tick: the importer may read variables, and request an early return.
  const auto watch = [=](double time, double* until) {
    bool requested = false;
    if (update) update(environment, time, false, true, true, early_return, &requested, until);
    return requested && early_return;
  };
  if (Instance* one = fmu::make_instance(name, logging, send, watch)) return one;
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
void fmi3FreeInstance(fmi3Instance instance) { delete static_cast<Instance*>(instance); }

fmi3Status fmi3EnterInitializationMode(fmi3Instance instance, fmi3Boolean, fmi3Float64,
                                       fmi3Float64 start, fmi3Boolean has_stop, fmi3Float64 stop) {
  return fmu::in(fmu::kInstantiated, instance, "fmi3EnterInitializationMode", [&](Instance& one) {
    const fmu::Status status = one.set_times(start, has_stop, stop);
    return status == fmu::kOk ? one.enter_initialization() : status;
  });
}
FMI_CALL(fmi3ExitInitializationMode, fmu::kInitialization, exit_initialization())
FMI_CALL(fmi3Terminate, fmu::kStep, terminate())
FMI_CALL(fmi3Reset, fmu::kAnyMode, reset())

fmi3Status fmi3DoStep(fmi3Instance instance, fmi3Float64 time, fmi3Float64 step, fmi3Boolean,
                      fmi3Boolean* event_handling_needed, fmi3Boolean* terminate,
                      fmi3Boolean* early_return, fmi3Float64* last_successful_time) {
  for (fmi3Boolean* flag : {event_handling_needed, terminate, early_return})
    if (flag) *flag = false;
  const fmi3Status status = fmu::in(fmu::kStep, instance, "fmi3DoStep",
                                    [&](Instance& one) { return one.do_step(time, step); });
  const auto* const one = static_cast<const Instance*>(instance);
  if (one && last_successful_time) *last_successful_time = one->time();
  if (one && early_return) *early_return = one->returned_early();
  return status;
}

// ---------------------------------------------------------------------------------- variables

#define REFERENCES const fmi3ValueReference references[], size_t count
#define GET(Name, type_)                                                                   \
  FMI_CALL(fmi3Get##Name, fmu::kAnyMode,                                                   \
           get(name, references, count, fmu::Type::type_, fmu::Type::type_, values, size), \
           REFERENCES, fmi3##Name values[], size_t size)
GET(Float64, float64)
GET(Int64, int64)
GET(Int32, int32)
GET(Boolean, boolean)
FMI_CALL(fmi3SetFloat64, fmu::kSettable, set_numbers(name, references, count, values, size),
         REFERENCES, const fmi3Float64 values[], size_t size)
// Not every importer writes 0 or 1, and a bool must be no other.
FMI_CALL(fmi3SetBoolean, fmu::kSettable,
         set_flags(name, references, count, reinterpret_cast<const unsigned char*>(values), size),
         REFERENCES, const fmi3Boolean values[], size_t size)
FMI_CALL(fmi3SetInt64, fmu::kSettable,
         take(name, references, count, fmu::Type::int64, values, size), REFERENCES,
         const fmi3Int64 values[], size_t size)
FMI_CALL(fmi3SetInt32, fmu::kSettable,
         take(name, references, count, fmu::Type::int32, values, size), REFERENCES,
         const fmi3Int32 values[], size_t size)

// Calls of types that no variable has: they accept an empty list alone.
#define NONE_OF_TYPE(Name)                                                              \
  FMI_CALL(fmi3Get##Name, fmu::kAnyMode, none(name, count), const fmi3ValueReference[], \
           size_t count, fmi3##Name[], size_t)                                          \
  FMI_CALL(fmi3Set##Name, fmu::kAnyMode, none(name, count), const fmi3ValueReference[], \
           size_t count, const fmi3##Name[], size_t)
NONE_OF_TYPE(Float32)
NONE_OF_TYPE(Int8)
NONE_OF_TYPE(UInt8)
NONE_OF_TYPE(Int16)
NONE_OF_TYPE(UInt16)
NONE_OF_TYPE(UInt32)
NONE_OF_TYPE(UInt64)
NONE_OF_TYPE(String)
FMI_CALL(fmi3GetBinary, fmu::kAnyMode, none(name, count), const fmi3ValueReference[], size_t count,
         size_t[], fmi3Binary[], size_t)
FMI_CALL(fmi3SetBinary, fmu::kAnyMode, none(name, count), const fmi3ValueReference[], size_t count,
         const size_t[], const fmi3Binary[], size_t)
FMI_CALL(fmi3GetClock, fmu::kAnyMode, none(name, count), const fmi3ValueReference[], size_t count,
         fmi3Clock[])
FMI_CALL(fmi3SetClock, fmu::kAnyMode, none(name, count), const fmi3ValueReference[], size_t count,
         const fmi3Clock[])

// -------------------------------------------------------------------------------- whole states

FMI_CALL(fmi3GetFMUState, fmu::kAnyMode, keep(state), fmi3FMUState* state)
FMI_CALL(fmi3SetFMUState, fmu::kAnyMode, restore_state(state), fmi3FMUState state)
FMI_CALL(fmi3FreeFMUState, fmu::kAnyMode, forget(state), fmi3FMUState* state)
FMI_CALL(fmi3SerializedFMUStateSize, fmu::kAnyMode, size_of(state, size), fmi3FMUState state,
         size_t* size)
FMI_CALL(fmi3SerializeFMUState, fmu::kAnyMode, write_state(state, bytes, size), fmi3FMUState state,
         fmi3Byte bytes[], size_t size)
FMI_CALL(fmi3DeserializeFMUState, fmu::kAnyMode, read_state(bytes, size, state),
         const fmi3Byte bytes[], size_t size, fmi3FMUState* state)

// ------------------------------------------------------------------------------- not supported

#undef REFERENCES
#define REFERENCES const fmi3ValueReference[], size_t
FMI_NOT_THERE(fmi3EnterEventMode)
FMI_NOT_THERE(fmi3EnterStepMode)
FMI_NOT_THERE(fmi3EnterConfigurationMode)
FMI_NOT_THERE(fmi3ExitConfigurationMode)
FMI_NOT_THERE(fmi3EvaluateDiscreteStates)
FMI_NOT_THERE(fmi3UpdateDiscreteStates, fmi3Boolean*, fmi3Boolean*, fmi3Boolean*, fmi3Boolean*,
              fmi3Boolean*, fmi3Float64*)
FMI_NOT_THERE(fmi3GetNumberOfVariableDependencies, fmi3ValueReference, size_t*)
FMI_NOT_THERE(fmi3GetVariableDependencies, fmi3ValueReference, size_t[], fmi3ValueReference[],
              size_t[], fmi3DependencyKind[], size_t)
FMI_NOT_THERE(fmi3GetDirectionalDerivative, REFERENCES, REFERENCES, const fmi3Float64[], size_t,
              fmi3Float64[], size_t)
FMI_NOT_THERE(fmi3GetAdjointDerivative, REFERENCES, REFERENCES, const fmi3Float64[], size_t,
              fmi3Float64[], size_t)
FMI_NOT_THERE(fmi3GetOutputDerivatives, REFERENCES, const fmi3Int32[], fmi3Float64[], size_t)
FMI_NOT_THERE(fmi3GetIntervalDecimal, REFERENCES, fmi3Float64[], fmi3IntervalQualifier[])
FMI_NOT_THERE(fmi3GetIntervalFraction, REFERENCES, fmi3UInt64[], fmi3UInt64[],
              fmi3IntervalQualifier[])
FMI_NOT_THERE(fmi3GetShiftDecimal, REFERENCES, fmi3Float64[])
FMI_NOT_THERE(fmi3GetShiftFraction, REFERENCES, fmi3UInt64[], fmi3UInt64[])
FMI_NOT_THERE(fmi3SetIntervalDecimal, REFERENCES, const fmi3Float64[])
FMI_NOT_THERE(fmi3SetIntervalFraction, REFERENCES, const fmi3UInt64[], const fmi3UInt64[])
FMI_NOT_THERE(fmi3SetShiftDecimal, REFERENCES, const fmi3Float64[])
FMI_NOT_THERE(fmi3SetShiftFraction, REFERENCES, const fmi3UInt64[], const fmi3UInt64[])
FMI_NOT_THERE(fmi3EnterContinuousTimeMode)
FMI_NOT_THERE(fmi3CompletedIntegratorStep, fmi3Boolean, fmi3Boolean*, fmi3Boolean*)
FMI_NOT_THERE(fmi3SetTime, fmi3Float64)
FMI_NOT_THERE(fmi3SetContinuousStates, const fmi3Float64[], size_t)
FMI_NOT_THERE(fmi3GetContinuousStateDerivatives, fmi3Float64[], size_t)
FMI_NOT_THERE(fmi3GetEventIndicators, fmi3Float64[], size_t)
FMI_NOT_THERE(fmi3GetContinuousStates, fmi3Float64[], size_t)
FMI_NOT_THERE(fmi3GetNominalsOfContinuousStates, fmi3Float64[], size_t)
FMI_NOT_THERE(fmi3GetNumberOfEventIndicators, size_t*)
FMI_NOT_THERE(fmi3GetNumberOfContinuousStates, size_t*)
FMI_NOT_THERE(fmi3ActivateModelPartition, fmi3ValueReference, fmi3Float64)
