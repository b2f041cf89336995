// Thumb instructions, as far as the emulator looks at them.
#pragma once

#include <unicorn/unicorn.h>

#include <cstdint>

namespace mcu::thumb {

constexpr uint16_t WFE = 0xbf20, YIELD = 0xbf10;

// In bytes. The first half of a long one: 0b11101 and up.
inline uint32_t length(const uint8_t* code) { return (code[1] & 0xf8) >= 0xe8 ? 4 : 2; }

inline bool is_wfi(const uint16_t* code) {
  return code[0] == 0xbf30 || (code[0] == 0xf3af && code[1] == 0x8003);
}

// The address that a load or a store with an offset from a register leads to; base 0: another one.
struct Access {
  int base;
  uint32_t offset;
};
inline Access decode_access(const uint16_t* code) {
  static constexpr int NAMES[] = {UC_ARM_REG_R0,  UC_ARM_REG_R1, UC_ARM_REG_R2,  UC_ARM_REG_R3,
                                  UC_ARM_REG_R4,  UC_ARM_REG_R5, UC_ARM_REG_R6,  UC_ARM_REG_R7,
                                  UC_ARM_REG_R8,  UC_ARM_REG_R9, UC_ARM_REG_R10, UC_ARM_REG_R11,
                                  UC_ARM_REG_R12, UC_ARM_REG_SP, UC_ARM_REG_LR,  UC_ARM_REG_PC};
  if ((code[0] & 0xf000) == 0x6000) return {NAMES[code[0] >> 3 & 7], 4u * (code[0] >> 6 & 31)};
  if ((code[0] & 0xffe0) == 0xf8c0) return {NAMES[code[0] & 15], code[1] & 0xfffu};
  return {0, 0};
}

}  // namespace mcu::thumb
