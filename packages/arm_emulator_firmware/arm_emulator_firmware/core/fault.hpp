// Faults of the processor, and those that Unicorn reports by numbers of its own.
#pragma once

#include <unicorn/unicorn.h>

#include <cstdint>

namespace mcu {

// Reason for which the processor cannot continue.
struct Fault {
  enum class Kind {
    none,  // of the emulator's own: no processor has a handler for it
    bus,
    bus_fetch,
    memory_fetch,
    undefined,
    state,
    coprocessor,
    unaligned,
    breakpoint,
    escalated  // a supervisor call that is masked
  };
  const char* what = nullptr;
  uint32_t address = 0;
  bool has_address = false;
  Kind kind = Kind::none;
};

// Kind and reason of an exception of Unicorn's.
struct Reason {
  Fault::Kind kind;
  const char* what;
};
inline Reason describe_fault(uint32_t number) {
  using Kind = Fault::Kind;
  switch (number) {
    case 3:
      return {Kind::bus_fetch, "instructions from where none can be"};
    case 4:
      return {Kind::bus, "an access that memory refuses"};
    case 7:
      return {Kind::breakpoint, "a breakpoint instruction"};
    case 17:
      return {Kind::coprocessor, "an instruction for a coprocessor that is not there"};
    case 18:
      return {Kind::state, "a branch to Arm instructions, which a Cortex-M does not have"};
    case 20:
      return {Kind::bus, "an exclusive access that memory refuses"};
    case 22:
      return {Kind::unaligned, "an unaligned access by an instruction that cannot do it"};
    default:
      return {Kind::none, "an exception of the processor"};
  }
}
// The same of an access to an address without memory.
inline Reason describe_fault(uc_mem_type type) {
  switch (type) {
    case UC_MEM_WRITE_UNMAPPED:
      return {Fault::Kind::bus, "write to an address where nothing is"};
    case UC_MEM_WRITE_PROT:
      return {Fault::Kind::bus, "write to flash"};
    case UC_MEM_FETCH_UNMAPPED:
    case UC_MEM_FETCH_PROT:
      return {Fault::Kind::bus_fetch, "instructions from an address where none are"};
    default:
      return {Fault::Kind::bus, "read of an address where nothing is"};
  }
}

}  // namespace mcu
