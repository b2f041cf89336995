// The functions of FMI 2.0 for co-simulation, over one machine per instance (instance.hpp). Every
// variable is one number here, and counts are real numbers, since integers have 32 bits.
#include "fmi2.h"

#include "instance.hpp"

namespace {

using fmu::Instance;
using fmu::Type;

Instance* of(fmi2Component component) { return static_cast<Instance*>(component); }

fmi2Status as_fmi2(fmu::Status status) { return static_cast<fmi2Status>(status); }

// Return the result of `call` if the instance is in one of these modes.
template <class Call>
fmi2Status in(std::uint32_t modes, fmi2Component component, const char* name, Call&& call) {
  if (!component || !of(component)->allows(modes, name)) return fmi2Error;
  try {
    return as_fmi2(call(*of(component)));
  } catch (const std::bad_alloc&) {
    return as_fmi2(of(component)->report(fmu::kError, "%s: there is no memory left", name));
  }
}

// each(one, variable) is its value.
template <class Value, class Call>
fmi2Status get(fmi2Component component, const char* name, const fmi2ValueReference* references,
               std::size_t count, Type type, Type other, Value* values, Call&& each) {
  return in(fmu::kAnyMode, component, name, [&](Instance& one) {
    if (!one.match(name, references, count, type, other, values, count)) return fmu::kError;
    one.look(references, count);
    for (std::size_t r = 0; r < count; ++r)
      values[r] = static_cast<Value>(each(one, fmu::kVariables[references[r]]));
    return fmu::kOk;
  });
}

template <class Call>
fmi2Status set(fmi2Component component, const char* name, const fmi2ValueReference* references,
               std::size_t count, Type type, const void* values, Call&& call) {
  return in(fmu::kSettable, component, name, [&](Instance& one) {
    if (!one.match(name, references, count, type, type, values, count) ||
        !one.settable(name, references, count))
      return fmu::kError;
    return call(one);
  });
}

fmi2Status no_strings(fmi2Component component, const char* name, std::size_t count) {
  return in(fmu::kAnyMode, component, name, [&](Instance& one) {
    return count ? one.report(fmu::kError, "%s: no variable is of this type", name) : fmu::kOk;
  });
}

// Functions that modelDescription.xml declares as missing.
fmi2Status not_there(fmi2Component component, const char* name) {
  if (!component) return fmi2Error;
  return as_fmi2(of(component)->report(fmu::kError, "%s is not supported", name));
}

void log_to(const fmu::Log& log, fmu::Status status, const char* category, const char* text) {
  reinterpret_cast<fmi2CallbackLogger>(log.function)(log.environment, log.name, as_fmi2(status),
                                                     category, "%s", text);
}

}  // namespace

const char* fmi2GetTypesPlatform(void) { return "default"; }
const char* fmi2GetVersion(void) { return "2.0"; }

fmi2Status fmi2SetDebugLogging(fmi2Component component, fmi2Boolean on, size_t count,
                               const fmi2String categories[]) {
  return in(fmu::kAnyMode, component, "fmi2SetDebugLogging",
            [&](Instance& one) { return one.set_logging(on, count, categories); });
}

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String,
                              const fmi2CallbackFunctions* functions, fmi2Boolean,
                              fmi2Boolean logging) {
  const fmi2CallbackFunctions none = {};
  const fmi2CallbackFunctions& given = functions ? *functions : none;
  const char* reason = nullptr;
  if (!name || !*name) reason = "instance name must be given";
  if (type != fmi2CoSimulation) reason = "model exchange is not supported, co-simulation is";
  if (!guid || std::strcmp(guid, fmu::kToken) != 0)
    reason = "guid must be that of modelDescription.xml";
  if (!reason) {
    const fmu::Log log = {log_to, reinterpret_cast<void (*)()>(given.logger),
                          given.componentEnvironment, ""};
    if (Instance* one = fmu::make_instance(name, logging, log)) return one;
    reason = "the machine cannot be made";
  }
  if (given.logger)
    given.logger(given.componentEnvironment, name ? name : "", fmi2Error,
                 fmu::kCategoryNames[fmu::kStatusError], "%s", reason);
  return nullptr;
}
void fmi2FreeInstance(fmi2Component component) { delete of(component); }

fmi2Status fmi2SetupExperiment(fmi2Component component, fmi2Boolean, fmi2Real, fmi2Real start,
                               fmi2Boolean has_stop, fmi2Real stop) {
  return in(fmu::kInstantiated, component, "fmi2SetupExperiment",
            [&](Instance& one) { return one.set_times(start, has_stop, stop); });
}
fmi2Status fmi2EnterInitializationMode(fmi2Component component) {
  return in(fmu::kInstantiated, component, "fmi2EnterInitializationMode",
            [](Instance& one) { return one.enter_initialization(); });
}
fmi2Status fmi2ExitInitializationMode(fmi2Component component) {
  return in(fmu::kInitialization, component, "fmi2ExitInitializationMode",
            [](Instance& one) { return one.exit_initialization(); });
}
fmi2Status fmi2Terminate(fmi2Component component) {
  return in(fmu::kStep, component, "fmi2Terminate", [](Instance& one) { return one.terminate(); });
}
fmi2Status fmi2Reset(fmi2Component component) {
  return in(fmu::kAnyMode, component, "fmi2Reset", [](Instance& one) { return one.reset(); });
}
fmi2Status fmi2DoStep(fmi2Component component, fmi2Real time, fmi2Real step, fmi2Boolean) {
  return in(fmu::kStep, component, "fmi2DoStep",
            [&](Instance& one) { return one.do_step(time, step); });
}

// --------------------------------------------------------------------------------------- variables

fmi2Status fmi2GetReal(fmi2Component component, const fmi2ValueReference references[], size_t count,
                       fmi2Real values[]) {
  return get(component, "fmi2GetReal", references, count, Type::float64, Type::int64, values,
             [](Instance& one, const fmu::Variable& of) { return one.value<double>(of, 0); });
}
fmi2Status fmi2GetInteger(fmi2Component component, const fmi2ValueReference references[],
                          size_t count, fmi2Integer values[]) {
  return get(component, "fmi2GetInteger", references, count, Type::int32, Type::int32, values,
             [](Instance& one, const fmu::Variable& of) { return one.value<std::int32_t>(of, 0); });
}
fmi2Status fmi2GetBoolean(fmi2Component component, const fmi2ValueReference references[],
                          size_t count, fmi2Boolean values[]) {
  return get(component, "fmi2GetBoolean", references, count, Type::boolean, Type::boolean, values,
             [](Instance& one, const fmu::Variable& of) { return one.value<bool>(of, 0); });
}
fmi2Status fmi2SetReal(fmi2Component component, const fmi2ValueReference references[], size_t count,
                       const fmi2Real values[]) {
  return set(
      component, "fmi2SetReal", references, count, Type::float64, values,
      [&](Instance& one) { return one.set_numbers("fmi2SetReal", references, count, values); });
}
fmi2Status fmi2SetBoolean(fmi2Component component, const fmi2ValueReference references[],
                          size_t count, const fmi2Boolean values[]) {
  return set(component, "fmi2SetBoolean", references, count, Type::boolean, values,
             [&](Instance& one) {
               for (size_t r = 0; r < count; ++r) one.set_flag(references[r], 0, values[r] != 0);
               return fmu::kOk;
             });
}
// Integers are outputs.
fmi2Status fmi2SetInteger(fmi2Component component, const fmi2ValueReference references[],
                          size_t count, const fmi2Integer values[]) {
  return set(component, "fmi2SetInteger", references, count, Type::int32, values,
             [](Instance&) { return fmu::kOk; });
}
fmi2Status fmi2GetString(fmi2Component component, const fmi2ValueReference[], size_t count,
                         fmi2String[]) {
  return no_strings(component, "fmi2GetString", count);
}
fmi2Status fmi2SetString(fmi2Component component, const fmi2ValueReference[], size_t count,
                         const fmi2String[]) {
  return no_strings(component, "fmi2SetString", count);
}

// ------------------------------------------------------------------------------------ whole states

fmi2Status fmi2GetFMUstate(fmi2Component component, fmi2FMUstate* state) {
  return in(fmu::kAnyMode, component, "fmi2GetFMUstate",
            [&](Instance& one) { return one.keep(state); });
}
fmi2Status fmi2SetFMUstate(fmi2Component component, fmi2FMUstate state) {
  return in(fmu::kAnyMode, component, "fmi2SetFMUstate",
            [&](Instance& one) { return one.go_back_to(state); });
}
fmi2Status fmi2FreeFMUstate(fmi2Component component, fmi2FMUstate* state) {
  return in(fmu::kAnyMode, component, "fmi2FreeFMUstate",
            [&](Instance& one) { return one.forget(state); });
}
fmi2Status fmi2SerializedFMUstateSize(fmi2Component component, fmi2FMUstate state, size_t* size) {
  return in(fmu::kAnyMode, component, "fmi2SerializedFMUstateSize",
            [&](Instance& one) { return one.size_of(state, size); });
}
fmi2Status fmi2SerializeFMUstate(fmi2Component component, fmi2FMUstate state, fmi2Byte bytes[],
                                 size_t size) {
  return in(fmu::kAnyMode, component, "fmi2SerializeFMUstate", [&](Instance& one) {
    return one.write_state(state, reinterpret_cast<unsigned char*>(bytes), size);
  });
}
fmi2Status fmi2DeSerializeFMUstate(fmi2Component component, const fmi2Byte bytes[], size_t size,
                                   fmi2FMUstate* state) {
  return in(fmu::kAnyMode, component, "fmi2DeSerializeFMUstate", [&](Instance& one) {
    return one.read_state(reinterpret_cast<const unsigned char*>(bytes), size, state);
  });
}

// -------------------------------------------------------------------------------- status of a step

// A step is over when it returns, and one that was discarded has moved nothing, unless it was
// cancelled from another thread.
fmi2Status fmi2GetRealStatus(fmi2Component component, const fmi2StatusKind kind, fmi2Real* value) {
  if (kind != fmi2LastSuccessfulTime || !value) return not_there(component, "fmi2GetRealStatus");
  return in(fmu::kAnyMode, component, "fmi2GetRealStatus", [&](Instance& one) {
    *value = one.time();
    return fmu::kOk;
  });
}
fmi2Status fmi2GetBooleanStatus(fmi2Component component, const fmi2StatusKind kind,
                                fmi2Boolean* value) {
  if (kind != fmi2Terminated || !value) return not_there(component, "fmi2GetBooleanStatus");
  return in(fmu::kAnyMode, component, "fmi2GetBooleanStatus", [&](Instance&) {
    *value = false;
    return fmu::kOk;
  });
}
fmi2Status fmi2GetStatus(fmi2Component component, const fmi2StatusKind, fmi2Status*) {
  return not_there(component, "fmi2GetStatus");
}
fmi2Status fmi2GetIntegerStatus(fmi2Component component, const fmi2StatusKind, fmi2Integer*) {
  return not_there(component, "fmi2GetIntegerStatus");
}
fmi2Status fmi2GetStringStatus(fmi2Component component, const fmi2StatusKind, fmi2String*) {
  return not_there(component, "fmi2GetStringStatus");
}
fmi2Status fmi2CancelStep(fmi2Component component) {
  return in(fmu::kStep, component, "fmi2CancelStep",
            [](Instance& one) { return one.cancel_step(); });
}
fmi2Status fmi2GetDirectionalDerivative(fmi2Component component, const fmi2ValueReference[], size_t,
                                        const fmi2ValueReference[], size_t, const fmi2Real[],
                                        fmi2Real[]) {
  return not_there(component, "fmi2GetDirectionalDerivative");
}
fmi2Status fmi2SetRealInputDerivatives(fmi2Component component, const fmi2ValueReference[], size_t,
                                       const fmi2Integer[], const fmi2Real[]) {
  return not_there(component, "fmi2SetRealInputDerivatives");
}
fmi2Status fmi2GetRealOutputDerivatives(fmi2Component component, const fmi2ValueReference[], size_t,
                                        const fmi2Integer[], fmi2Real[]) {
  return not_there(component, "fmi2GetRealOutputDerivatives");
}
