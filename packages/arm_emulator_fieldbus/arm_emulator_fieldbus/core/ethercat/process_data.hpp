// Process data: in each servo period the entries of the mapping are copied between a buffer and the
// drive. The mapping (0x1600.., 0x1A00..) is that of the assigned objects (0x1C12, 0x1C13).
#pragma once

#include <array>

#include "../drive.hpp"

namespace ethercat {

using fieldbus::Drive;

// One way of process data.
class ProcessData {
 public:
  enum class Way : std::uint16_t { outputs = 0x1c12, inputs = 0x1c13 };

  ProcessData(Drive& drive, Way way) : drive_(drive), direction_(way) {}

  // Takes over the present mapping. The dictionary ensures that all of it can be mapped, in whole
  // bytes.
  void compile() {
    count_ = drive_.values().process_data(static_cast<std::uint16_t>(direction_), items_);
    bytes_ = 0;
    for (const fieldbus::Mapped& item : items()) bytes_ += bytes(item);
  }
  std::size_t size() const { return bytes_; }

  void write_outputs(const std::uint8_t* buffer) const {
    for (const fieldbus::Mapped& item : items()) {
      drive_.write_mapped(item, reinterpret_cast<const std::byte*>(buffer));
      buffer += bytes(item);
    }
  }
  void read_inputs(std::uint8_t* buffer) const {
    for (const fieldbus::Mapped& item : items()) {
      drive_.read_mapped(item, reinterpret_cast<std::byte*>(buffer));
      buffer += bytes(item);
    }
  }

 private:
  static std::size_t bytes(const fieldbus::Mapped& item) {
    return static_cast<std::size_t>(item.bits) / 8;
  }
  std::span<const fieldbus::Mapped> items() const {
    return std::span(items_).first(static_cast<std::size_t>(count_));
  }

  Drive& drive_;
  Way direction_;
  std::array<fieldbus::Mapped, fieldbus::Values::kMostMapped> items_ = {};
  int count_ = 0;
  std::size_t bytes_ = 0;
};

}  // namespace ethercat
