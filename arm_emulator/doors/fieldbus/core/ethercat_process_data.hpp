// Process data: what the mapping (0x1600.., 0x1A00..) of the assigned objects (0x1C12, 0x1C13) says
// goes between a buffer and the drive in each servo period.
#pragma once

#include <vector>

#include "ethercat_frame.hpp"
#include "ethercat_objects.hpp"
#include "ethercat_sii.hpp"

namespace ethercat {

// One way of process data.
class ProcessData {
 public:
  enum class Way : std::uint16_t { OUTPUTS = 0x1c12, INPUTS = 0x1c13 };

  ProcessData(const Objects& objects, const Door& door, Way way)
      : objects(objects), door(door), way(way) {}

  // Takes over the mapping as it is now. The dictionary has seen to it that all of it can be
  // mapped, in whole bytes.
  void compile() {
    items.clear();
    bytes = 0;
    for (const Pdo& pdo : assigned())
      for (const PdoEntry& entry : pdo.entries) {
        const std::size_t here = entry.bits / 8u;
        if (entry.index != 0)
          items.push_back({entry.index, entry.subindex, bytes, here});  // no gap
        bytes += here;
      }
  }
  std::size_t size() const { return bytes; }

  void to_drive(const std::uint8_t* buffer) const {
    for (const Item& item : items) door.write(item.index, item.sub, {buffer + item.at, item.size});
  }
  void from_drive(std::uint8_t* buffer) const {
    std::uint32_t size = 0;
    for (const Item& item : items)
      door.read(item.index, item.sub, {buffer + item.at, item.size}, size);
  }

  // The process data objects that are assigned now, with what is mapped into them.
  std::vector<Pdo> assigned() const {
    std::vector<Pdo> out;
    const auto assignment = static_cast<std::uint16_t>(way);
    const std::uint32_t count = door.number(assignment, 0);
    for (std::uint32_t k = 1; k <= count; ++k) {
      const auto index =
          static_cast<std::uint16_t>(door.number(assignment, static_cast<std::uint8_t>(k)));
      if (index != 0) out.push_back(object(index));
    }
    return out;
  }
  // Every object of this way.
  std::vector<Pdo> all() const {
    std::vector<Pdo> out;
    const std::vector<Pdo> now = assigned();
    const std::uint16_t from = way == Way::OUTPUTS ? 0x1600 : 0x1a00;
    for (const std::uint16_t index : objects.all()) {
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
    const auto its = objects.object(index);
    Pdo pdo = {index, way == Way::OUTPUTS ? 2 : 3, {}, its.empty() ? "" : its[0].object};
    const std::uint32_t count = door.number(index, 0);
    for (std::uint32_t k = 1; k <= count; ++k) {
      const std::uint32_t mapped = door.number(index, static_cast<std::uint8_t>(k));
      const auto at = static_cast<std::uint16_t>(mapped >> 16);
      const auto sub = static_cast<std::uint8_t>(mapped >> 8);
      const drives_entry* const entry = objects.entry(at, sub);
      pdo.entries.push_back({at, sub, static_cast<std::uint8_t>(mapped),
                             static_cast<std::uint8_t>(entry ? entry->type : 0),
                             entry ? entry->name : ""});
    }
    return pdo;
  }

  const Objects& objects;
  const Door& door;
  Way way;
  std::vector<Item> items;
  std::size_t bytes = 0;
};

}  // namespace ethercat
