// The bus between the processor and memory-mapped registers.
#pragma once

#include <cstdint>

namespace mcu {

// Reads and writes of the processor, by address.
class Bus {
 public:
  virtual ~Bus() = default;
  virtual uint32_t read(uint32_t at, unsigned size) = 0;
  virtual void write(uint32_t at, unsigned size, uint32_t value) = 0;
};

}  // namespace mcu
