// Common part of the functions of both versions of FMI: an instance does the work, in the modes in
// which a call is allowed.
//
// Included after the header of the version, whose types are `FmiStatus` and `FmiInstance`.
#pragma once

#include "instance.hpp"

namespace fmu {

inline FmiStatus to_fmi_status(Status status) { return static_cast<FmiStatus>(status); }

// Return the result of `call` if the instance is in one of these modes.
template <class Call>
FmiStatus in(std::uint32_t modes, FmiInstance instance, const char* name, Call&& call) {
  auto* const one = static_cast<Instance*>(instance);
  if (!one || !one->allows(modes, name)) return to_fmi_status(kError);
  try {
    return to_fmi_status(call(*one));
  } catch (const std::bad_alloc&) {
    return to_fmi_status(one->report(kError, "%s: there is no memory left", name));
  }
}

// Functions that modelDescription.xml declares as missing.
inline FmiStatus report_missing(FmiInstance instance, const char* name) {
  if (!instance) return to_fmi_status(kError);
  return to_fmi_status(
      static_cast<Instance*>(instance)->report(kError, "%s is not supported", name));
}

}  // namespace fmu

// A function of the standard that is one of `Instance`, in some modes; its parameters follow.
#define FMI_CALL(function, modes, call, ...)                                             \
  FmiStatus function(FmiInstance instance __VA_OPT__(, ) __VA_ARGS__) {                  \
    [[maybe_unused]] const char* const name = #function;                                 \
    return fmu::in(modes, instance, name, [&](fmu::Instance& one) { return one.call; }); \
  }
#define FMI_NOT_THERE(function, ...)                                    \
  FmiStatus function(FmiInstance instance __VA_OPT__(, ) __VA_ARGS__) { \
    return fmu::report_missing(instance, #function);                    \
  }
