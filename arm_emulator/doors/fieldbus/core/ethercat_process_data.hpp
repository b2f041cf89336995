// Process data: the entries in the mapping (0x1600.., 0x1A00..) of the assigned objects (0x1C12,
// 0x1C13) go between a buffer and the drive in each servo period.
#pragma once

#include <vector>

#include "ethercat_frame.hpp"
#include "ethercat_objects.hpp"
#include "ethercat_sii.hpp"

namespace ethercat {

// One way of process data.
class ProcessData {
 public:
  enum class Way : std::uint16_t { outputs = 0x1c12, inputs = 0x1c13 };

  ProcessData(const Objects& objects, const Door& door, Way way)
      : objects_(objects), door_(door), way_(way) {}

  // Takes over the present mapping. The dictionary ensures that all of it can be mapped, in whole
  // bytes.
  void compile() {
    items_.clear();
    bytes_ = 0;
    for (const Pdo& pdo : assigned())
      for (const PdoEntry& entry : pdo.entries) {
        const std::size_t here = entry.bits / 8u;
        if (entry.index != 0)
          items_.push_back({entry.index, entry.subindex, bytes_, here});  // no gap
        bytes_ += here;
      }
  }
  std::size_t size() const { return bytes_; }

  void to_drive(const std::uint8_t* buffer) const {
    for (const Item& item : items_)
      door_.write(item.index, item.sub, {buffer + item.at, item.size});
  }
  void from_drive(std::uint8_t* buffer) const {
    std::uint32_t size = 0;
    for (const Item& item : items_)
      door_.read(item.index, item.sub, {buffer + item.at, item.size}, size);
  }

  // The process data objects that are assigned now, with what is mapped into them.
  std::vector<Pdo> assigned() const {
    std::vector<Pdo> out;
    const auto assignment = static_cast<std::uint16_t>(way_);
    const std::uint32_t count = door_.number(assignment, 0);
    for (std::uint32_t k = 1; k <= count; ++k) {
      const auto index =
          static_cast<std::uint16_t>(door_.number(assignment, static_cast<std::uint8_t>(k)));
      if (index != 0) out.push_back(object(index));
    }
    return out;
  }
  // Every object of this way.
  std::vector<Pdo> all() const {
    std::vector<Pdo> out;
    const std::vector<Pdo> now = assigned();
    const std::uint16_t from = way_ == Way::outputs ? 0x1600 : 0x1a00;
    for (const std::uint16_t index : objects_.all()) {
      if (index < from || index >= from + 0x200) continue;
      Pdo pdo = object(index);
      if (pdo.entries.empty()) continue;
      const bool in_use = std::any_of(now.begin(), now.end(),
                                      [index](const Pdo& one) { return one.index == index; });
      if (!in_use) pdo.sync_manager = -1;
      out.push_back(std::move(pdo));
    }
    return out;
  }

 private:
  struct Item {
    std::uint16_t index;
    std::uint8_t sub;
    std::size_t at, size;  // bytes
  };

  Pdo object(std::uint16_t index) const {
    const auto its = objects_.object(index);
    Pdo pdo = {index, way_ == Way::outputs ? 2 : 3, {}, its.empty() ? "" : its[0].object};
    const std::uint32_t count = door_.number(index, 0);
    for (std::uint32_t k = 1; k <= count; ++k) {
      const std::uint32_t mapped = door_.number(index, static_cast<std::uint8_t>(k));
      const auto at = static_cast<std::uint16_t>(mapped >> 16);
      const auto sub = static_cast<std::uint8_t>(mapped >> 8);
      const drives_entry* const entry = objects_.entry(at, sub);
      pdo.entries.push_back({at, sub, static_cast<std::uint8_t>(mapped),
                             static_cast<std::uint8_t>(entry ? entry->type : 0),
                             entry ? entry->name : ""});
    }
    return pdo;
  }

  const Objects& objects_;
  const Door& door_;
  Way way_;
  std::vector<Item> items_;
  std::size_t bytes_ = 0;
};

}  // namespace ethercat
