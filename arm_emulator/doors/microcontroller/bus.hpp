// Registers before the processor.
#pragma once

#include <cstdint>

namespace mcu {

// Registers that are mapped at addresses, as the processor sees them.
class Bus {
 public:
  virtual ~Bus() = default;
  virtual uint32_t read(uint32_t at, unsigned size) = 0;
  virtual void write(uint32_t at, unsigned size, uint32_t value) = 0;
};

}  // namespace mcu
