// A drive's dictionary as the SDO server of EtherCAT needs it: one entry, or all of an object at
// once (complete access, ETG.1000.6, section 5.6.2).
#pragma once

#include "../canopen/sdo.hpp"
#include "objects.hpp"

namespace ethercat {

using fieldbus::Bytes;
using fieldbus::SdoObject;

class Dictionary final : public fieldbus::DriveDictionary {
 public:
  using DriveDictionary::DriveDictionary;

  std::uint32_t read(const SdoObject& at, Bytes& out) const override {
    return at.complete ? read_all(at.index, at.sub, out) : DriveDictionary::read(at, out);
  }
  std::uint32_t write(const SdoObject& at, std::span<const std::uint8_t> in) override {
    return at.complete ? write_all(at.index, at.sub, in) : DriveDictionary::write(at, in);
  }

 private:
  std::uint32_t read_sub(std::uint16_t index, std::size_t sub, Bytes& out) const {
    return DriveDictionary::read({index, static_cast<std::uint8_t>(sub)}, out);
  }
  std::uint32_t write_sub(std::uint16_t index, std::size_t sub, std::span<const std::uint8_t> in) {
    return DriveDictionary::write({index, static_cast<std::uint8_t>(sub)}, in);
  }

  // Present number of sub-indices of an object: the value of sub 0, which masters set for mappings
  // and assignments.
  std::size_t subs(std::span<const Entry> object) const {
    return std::min<std::size_t>(drive_.values().number(object[0].index, 0), object.size() - 1);
  }

  std::uint32_t read_all(std::uint16_t index, std::uint8_t from, Bytes& out) const {
    const auto object = ethercat::object(index);
    if (object.empty()) return abort_code::no_object;
    if (from > 1) return abort_code::unsupported;
    if (object.size() == 1) return from == 0 ? read_sub(index, 0, out) : abort_code::no_sub;
    const std::size_t count = subs(object);
    if (from == 0) {
      out.push_back(static_cast<std::uint8_t>(count));
      out.push_back(0);  // sub 0 takes 16 bits
    }
    for (std::size_t sub = 1; sub <= count; ++sub) {
      const std::uint32_t abort = read_sub(index, sub, out);
      if (abort != 0) return abort;
    }
    return 0;
  }

  // All or nothing: written entries are restored when a later one is refused.
  std::uint32_t write_all(std::uint16_t index, std::uint8_t from,
                          std::span<const std::uint8_t> data) {
    const auto object = ethercat::object(index);
    if (object.empty()) return abort_code::no_object;
    if (from > 1) return abort_code::unsupported;
    if (object.size() == 1) return from == 0 ? write_sub(index, 0, data) : abort_code::no_sub;
    const bool counted = object[0].writable();  // mapping, assignment: sub 0 is 0 meanwhile
    std::vector<Bytes> before(object.size());
    for (std::size_t sub = 0; sub < object.size(); ++sub) read_sub(index, sub, before[sub]);
    const std::uint32_t abort = write_subs(object, from, data, counted);
    if (abort == 0) return 0;
    const std::uint8_t none[1] = {0};
    if (counted) write_sub(index, 0, none);
    for (std::size_t sub = 1; sub < object.size(); ++sub)
      if (object[sub].writable()) write_sub(index, sub, before[sub]);
    if (counted) write_sub(index, 0, before[0]);
    return abort;
  }

  std::uint32_t write_subs(std::span<const Entry> object, std::uint8_t from,
                           std::span<const std::uint8_t> data, bool counted) {
    const std::uint16_t index = object[0].index;
    std::uint8_t count = static_cast<std::uint8_t>(drive_.values().number(index, 0));
    if (from == 0) {
      if (data.empty()) return abort_code::too_short;
      if (counted) count = data[0];
      data = data.subspan(std::min<std::size_t>(2, data.size()));
    }
    const std::uint8_t none[1] = {0}, total[1] = {count};
    std::uint32_t abort = counted ? write_sub(index, 0, none) : 0;
    for (std::size_t sub = 1; abort == 0 && sub < object.size() && !data.empty(); ++sub) {
      const std::size_t size = (object[sub].bits + 7u) / 8;
      if (size == 0) return abort_code::unsupported;  // a text has no place of its own
      if (data.size() < size) return abort_code::too_short;
      if (object[sub].writable()) abort = write_sub(index, sub, data.first(size));
      data = data.subspan(size);
    }
    if (abort == 0 && !data.empty()) return abort_code::wrong_length;
    return abort == 0 && counted ? write_sub(index, 0, total) : abort;
  }
};

}  // namespace ethercat
