// The functions of FMI 2.0 for co-simulation, over one machine per instance (instance.hpp). Every
// variable is one number here, and counts are real numbers, since integers have 32 bits.
#include "fmi2.h"

using FmiStatus = fmi2Status;
using FmiInstance = fmi2Component;
#include "calls.hpp"

using fmu::Instance;

const char* fmi2GetTypesPlatform(void) { return "default"; }
const char* fmi2GetVersion(void) { return "2.0"; }

FMI_CALL(fmi2SetDebugLogging, fmu::kAnyMode, set_logging(on, count, categories), fmi2Boolean on,
         size_t count, const fmi2String categories[])

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String,
                              const fmi2CallbackFunctions* functions, fmi2Boolean,
                              fmi2Boolean logging) {
  const fmi2CallbackFunctions none = {};
  const fmi2CallbackFunctions& callbacks = functions ? *functions : none;
  const char* reason = nullptr;
  if (!name || !*name) reason = "instance name must be given";
  if (type != fmi2CoSimulation) reason = "model exchange is not supported, co-simulation is";
  if (!guid || std::strcmp(guid, fmu::kToken) != 0)
    reason = "guid must be that of modelDescription.xml";
  if (!reason) {
    const auto log = [to = callbacks.logger, environment = callbacks.componentEnvironment](
                         const char* one, fmu::Status status, const char* category,
                         const char* text) {
      if (to) to(environment, one, fmu::to_fmi_status(status), category, "%s", text);
    };
    if (Instance* one = fmu::make_instance(name, logging, log)) return one;
    reason = "the machine cannot be made";
  }
  if (callbacks.logger)
    callbacks.logger(callbacks.componentEnvironment, name ? name : "", fmi2Error,
                     fmu::kCategoryNames[fmu::kStatusError], "%s", reason);
  return nullptr;
}
void fmi2FreeInstance(fmi2Component component) { delete static_cast<Instance*>(component); }

FMI_CALL(fmi2SetupExperiment, fmu::kInstantiated, set_times(start, has_stop, stop), fmi2Boolean,
         fmi2Real, fmi2Real start, fmi2Boolean has_stop, fmi2Real stop)
FMI_CALL(fmi2EnterInitializationMode, fmu::kInstantiated, enter_initialization())
FMI_CALL(fmi2ExitInitializationMode, fmu::kInitialization, exit_initialization())
FMI_CALL(fmi2Terminate, fmu::kStep, terminate())
FMI_CALL(fmi2Reset, fmu::kAnyMode, reset())
FMI_CALL(fmi2DoStep, fmu::kStep, do_step(time, step), fmi2Real time, fmi2Real step, fmi2Boolean)

// --------------------------------------------------------------------------------------- variables

#define REFERENCES const fmi2ValueReference references[], size_t count
#define GET(Name, type_, other_)                                                             \
  FMI_CALL(fmi2Get##Name, fmu::kAnyMode,                                                     \
           get(name, references, count, fmu::Type::type_, fmu::Type::other_, values, count), \
           REFERENCES, fmi2##Name values[])
GET(Real, float64, int64)
GET(Integer, int32, int32)
GET(Boolean, boolean, boolean)
FMI_CALL(fmi2SetReal, fmu::kSettable, set_numbers(name, references, count, values, count),
         REFERENCES, const fmi2Real values[])
FMI_CALL(fmi2SetBoolean, fmu::kSettable, set_flags(name, references, count, values, count),
         REFERENCES, const fmi2Boolean values[])
FMI_CALL(fmi2SetInteger, fmu::kSettable,
         take(name, references, count, fmu::Type::int32, values, count), REFERENCES,
         const fmi2Integer values[])
FMI_CALL(fmi2GetString, fmu::kAnyMode, none(name, count), const fmi2ValueReference[], size_t count,
         fmi2String[])
FMI_CALL(fmi2SetString, fmu::kAnyMode, none(name, count), const fmi2ValueReference[], size_t count,
         const fmi2String[])

// ------------------------------------------------------------------------------------ whole states

FMI_CALL(fmi2GetFMUstate, fmu::kAnyMode, keep(state), fmi2FMUstate* state)
FMI_CALL(fmi2SetFMUstate, fmu::kAnyMode, restore_state(state), fmi2FMUstate state)
FMI_CALL(fmi2FreeFMUstate, fmu::kAnyMode, forget(state), fmi2FMUstate* state)
FMI_CALL(fmi2SerializedFMUstateSize, fmu::kAnyMode, size_of(state, size), fmi2FMUstate state,
         size_t* size)
FMI_CALL(fmi2SerializeFMUstate, fmu::kAnyMode, write_state(state, bytes, size), fmi2FMUstate state,
         fmi2Byte bytes[], size_t size)
FMI_CALL(fmi2DeSerializeFMUstate, fmu::kAnyMode, read_state(bytes, size, state),
         const fmi2Byte bytes[], size_t size, fmi2FMUstate* state)

// -------------------------------------------------------------------------------- status of a step

// A step is over when it returns, and one that was discarded has moved nothing, unless it was
// cancelled from another thread.
fmi2Status fmi2GetRealStatus(fmi2Component component, const fmi2StatusKind kind, fmi2Real* value) {
  if (kind != fmi2LastSuccessfulTime || !value)
    return fmu::report_missing(component, "fmi2GetRealStatus");
  return fmu::in(fmu::kAnyMode, component, "fmi2GetRealStatus", [&](Instance& one) {
    *value = one.time();
    return fmu::kOk;
  });
}
fmi2Status fmi2GetBooleanStatus(fmi2Component component, const fmi2StatusKind kind,
                                fmi2Boolean* value) {
  if (kind != fmi2Terminated || !value)
    return fmu::report_missing(component, "fmi2GetBooleanStatus");
  return fmu::in(fmu::kAnyMode, component, "fmi2GetBooleanStatus", [&](Instance&) {
    *value = false;
    return fmu::kOk;
  });
}
FMI_NOT_THERE(fmi2GetStatus, const fmi2StatusKind, fmi2Status*)
FMI_NOT_THERE(fmi2GetIntegerStatus, const fmi2StatusKind, fmi2Integer*)
FMI_NOT_THERE(fmi2GetStringStatus, const fmi2StatusKind, fmi2String*)
FMI_CALL(fmi2CancelStep, fmu::kStep, cancel_step())
#undef REFERENCES
#define REFERENCES const fmi2ValueReference[], size_t
FMI_NOT_THERE(fmi2GetDirectionalDerivative, REFERENCES, REFERENCES, const fmi2Real[], fmi2Real[])
FMI_NOT_THERE(fmi2SetRealInputDerivatives, REFERENCES, const fmi2Integer[], const fmi2Real[])
FMI_NOT_THERE(fmi2GetRealOutputDerivatives, REFERENCES, const fmi2Integer[], fmi2Real[])
