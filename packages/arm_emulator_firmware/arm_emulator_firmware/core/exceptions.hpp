// Begin and end of exceptions, with their frame on the stack (ARMv7-M, B1.5).
#pragma once

#include <array>
#include <cstdint>

#include "cpu.hpp"
#include "memory.hpp"

namespace mcu {

// Push the interrupted frame and continue in the handler; false: the stack pointer leads to no
// memory.
inline bool enter(Cpu& cpu, Memory& memory, int exception, uint32_t vectors) {
  uint32_t handler = 0;
  if (!memory.read(vectors + 4 * static_cast<uint32_t>(exception), &handler, 4))
    return cpu.fail("read of a vector outside of memory",
                    vectors + 4 * static_cast<uint32_t>(exception));
  if (!(handler & 1)) return cpu.fail("a vector that is no Thumb address", handler);
  const uint32_t xpsr = cpu.get(UC_ARM_REG_XPSR), control = cpu.get(UC_ARM_REG_CONTROL);
  const bool handling = xpsr & 0x1ff, with_fpu = control & 4, process = !handling && (control & 2);
  const uint32_t sp = cpu.get(UC_ARM_REG_SP), size = with_fpu ? 0x68 : 0x20;
  const bool aligned = !(sp & 4);
  const uint32_t at = (sp - size) & ~7u;
  std::array<uint32_t, 26> frame{};
  for (int k = 0; k < 4; ++k) frame[k] = cpu.get(UC_ARM_REG_R0 + k);
  frame[4] = cpu.get(UC_ARM_REG_R12);
  frame[5] = cpu.get(UC_ARM_REG_LR);
  frame[6] = cpu.pc;
  frame[7] = (xpsr & ~0x200u) | (aligned ? 0 : 0x200u);
  if (with_fpu) {
    for (int k = 0; k < 16; ++k) frame[8 + k] = cpu.get(UC_ARM_REG_S0 + k);
    frame[24] = cpu.get(UC_ARM_REG_FPSCR);
  }
  if (!memory.write(at, frame.data(), size)) return cpu.fail("stack outside of memory", at);
  cpu.set(UC_ARM_REG_SP, at);
  cpu.set(UC_ARM_REG_XPSR, (xpsr & 0xf8000000u) | 1u << 24 | static_cast<uint32_t>(exception));
  cpu.set(UC_ARM_REG_CONTROL, cpu.get(UC_ARM_REG_CONTROL) & ~4u);
  cpu.set(UC_ARM_REG_LR, (handling  ? 0xfffffff1u
                          : process ? 0xfffffffdu
                                    : 0xfffffff9u) &
                             (with_fpu ? ~0x10u : ~0u));
  cpu.refresh();
  cpu.pc = handler & ~1u;
  return true;
}

// Pop the interrupted frame; false: no such return exists.
inline bool leave(Cpu& cpu, const Memory& memory, uint32_t how) {
  const bool with_fpu = !(how & 0x10), process = (how & 0xf) == 0xd, thread = (how & 0xf) != 1;
  if ((how & 0xffffffe0u) != 0xffffffe0u || ((how & 0xf) != 1 && (how & 0xf) != 9 && !process))
    return cpu.fail("a wrong exception return", how);
  const int pointer = process ? UC_ARM_REG_PSP : UC_ARM_REG_MSP;
  const uint32_t at = cpu.get(pointer), size = with_fpu ? 0x68 : 0x20;
  std::array<uint32_t, 26> frame{};
  if (!memory.read(at, frame.data(), size)) return cpu.fail("stack outside of memory", at);
  const uint32_t xpsr = frame[7];
  if (thread != !(xpsr & 0x1ff) || !(xpsr & 1u << 24))
    return cpu.fail("an exception return to another mode than its stack holds", frame[6]);
  cpu.set(pointer, (at + size) | (xpsr & 0x200 ? 4u : 0u));
  const uint32_t control = cpu.get(UC_ARM_REG_CONTROL);
  cpu.set(UC_ARM_REG_CONTROL, control & ~5u);  // privileged until all is set
  cpu.set(UC_ARM_REG_XPSR_NZCVQG, xpsr & ~0x200u);
  if (thread) cpu.set(UC_ARM_REG_CONTROL, (control & ~7u) | (process ? 2u : 0u));
  for (int k = 0; k < 4; ++k) cpu.set(UC_ARM_REG_R0 + k, frame[k]);
  cpu.set(UC_ARM_REG_R12, frame[4]);
  cpu.set(UC_ARM_REG_LR, frame[5]);
  if (with_fpu) {
    for (int k = 0; k < 16; ++k) cpu.set(UC_ARM_REG_S0 + k, frame[8 + k]);
    cpu.set(UC_ARM_REG_FPSCR, frame[24]);
  }
  const uint32_t end = cpu.get(UC_ARM_REG_CONTROL) & ~5u;
  cpu.set(UC_ARM_REG_CONTROL, end | (with_fpu ? 4u : 0u) | (control & 1u));
  cpu.refresh();
  cpu.pc = frame[6] & ~1u;
  return true;
}

}  // namespace mcu
