// A drive's dictionary as the SDO server of EtherCAT needs it: one entry, or all of an object at
// once (complete access, ETG.1000.6, section 5.6.2).
#pragma once

#include "ethercat_objects.hpp"
#include "sdo_server.hpp"

namespace ethercat {

using fieldbus::Bytes;
using fieldbus::SdoObject;

class Dictionary final : public fieldbus::SdoDictionary {
 public:
  Dictionary(const Objects& objects, const Door& door) : objects_(objects), door_(door) {}

  std::uint32_t read(const SdoObject& at, Bytes& out) const override {
    return at.complete ? read_all(at.index, at.sub, out) : read_one(at.index, at.sub, out);
  }
  std::uint32_t write(const SdoObject& at, std::span<const std::uint8_t> in) override {
    return at.complete ? write_all(at.index, at.sub, in) : door_.write(at.index, at.sub, in);
  }
  bool has(std::uint16_t index) const override { return !objects_.object(index).empty(); }
  std::size_t length(const SdoObject& at) const override {
    const drives_entry* const entry = objects_.entry(at.index, at.sub);
    return entry && entry->bits ? (entry->bits + 7u) / 8 : 4;
  }

 private:
  std::uint32_t read_one(std::uint16_t index, std::uint8_t sub, Bytes& out) const {
    std::uint8_t value[512];
    std::uint32_t size = 0;
    const std::uint32_t abort = door_.read(index, sub, value, size);
    if (abort == 0) out.insert(out.end(), value, value + size);
    return abort;
  }

  // Present number of sub-indices of an object: the value of sub 0, which masters set for mappings
  // and assignments.
  std::size_t subs(std::span<const drives_entry> object) const {
    return std::min<std::size_t>(door_.number(object[0].index, 0), object.size() - 1);
  }

  std::uint32_t read_all(std::uint16_t index, std::uint8_t from, Bytes& out) const {
    const auto object = objects_.object(index);
    if (object.empty()) return abort_code::no_object;
    if (from > 1) return abort_code::unsupported;
    if (object.size() == 1) return from == 0 ? read_one(index, 0, out) : abort_code::no_sub;
    const std::size_t count = subs(object);
    if (from == 0) {
      out.push_back(static_cast<std::uint8_t>(count));
      out.push_back(0);  // sub 0 takes 16 bits
    }
    for (std::size_t sub = 1; sub <= count; ++sub) {
      const std::uint32_t abort = read_one(index, static_cast<std::uint8_t>(sub), out);
      if (abort != 0) return abort;
    }
    return 0;
  }

  // All or nothing: written entries are restored when a later one is refused.
  std::uint32_t write_all(std::uint16_t index, std::uint8_t from,
                          std::span<const std::uint8_t> data) {
    const auto object = objects_.object(index);
    if (object.empty()) return abort_code::no_object;
    if (from > 1) return abort_code::unsupported;
    if (object.size() == 1) return from == 0 ? door_.write(index, 0, data) : abort_code::no_sub;
    const bool counted = writable(object[0]);  // mapping, assignment: sub 0 is 0 meanwhile
    std::vector<Bytes> before(object.size());
    for (std::size_t sub = 0; sub < object.size(); ++sub)
      read_one(index, static_cast<std::uint8_t>(sub), before[sub]);
    const std::uint32_t abort = write_subs(object, from, data, counted);
    if (abort == 0) return 0;
    const std::uint8_t none[1] = {0};
    if (counted) door_.write(index, 0, none);
    for (std::size_t sub = 1; sub < object.size(); ++sub)
      if (writable(object[sub])) door_.write(index, static_cast<std::uint8_t>(sub), before[sub]);
    if (counted) door_.write(index, 0, before[0]);
    return abort;
  }

  std::uint32_t write_subs(std::span<const drives_entry> object, std::uint8_t from,
                           std::span<const std::uint8_t> data, bool counted) {
    const std::uint16_t index = object[0].index;
    std::uint8_t count = static_cast<std::uint8_t>(door_.number(index, 0));
    if (from == 0) {
      if (data.empty()) return abort_code::too_short;
      if (counted) count = data[0];
      data = data.subspan(std::min<std::size_t>(2, data.size()));
    }
    const std::uint8_t none[1] = {0}, total[1] = {count};
    std::uint32_t abort = counted ? door_.write(index, 0, none) : 0;
    for (std::size_t sub = 1; abort == 0 && sub < object.size() && !data.empty(); ++sub) {
      const std::size_t size = (object[sub].bits + 7u) / 8;
      if (size == 0) return abort_code::unsupported;  // a text has no place of its own
      if (data.size() < size) return abort_code::too_short;
      if (writable(object[sub]))
        abort = door_.write(index, static_cast<std::uint8_t>(sub), data.first(size));
      data = data.subspan(size);
    }
    if (abort == 0 && !data.empty()) return abort_code::wrong_length;
    return abort == 0 && counted ? door_.write(index, 0, total) : abort;
  }

  const Objects& objects_;
  const Door& door_;
};

}  // namespace ethercat
