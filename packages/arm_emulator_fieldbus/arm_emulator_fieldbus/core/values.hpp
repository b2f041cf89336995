// The values of one drive's object dictionary: reads and writes as an SDO server checks them, and
// which entries process data consist of.
#pragma once

#include <bit>
#include <cstring>

#include "canopen/rules.hpp"
#include "object_dictionary.hpp"

namespace fieldbus {

static_assert(std::endian::native == std::endian::little, "values lie in memory as on the wire");

// An entry in process data. Slot -1: so many bits that mean nothing.
struct Mapped {
  int slot = -1;
  int bits = 0;
};

inline constexpr int kLongestPdo = 64;  // bytes on EtherCAT; CANopen: 8
inline constexpr int kLongestText = 512;

class Values {
 public:
  explicit Values(Bus bus) : bus_(bus) { restore(); }

  Bus bus() const { return bus_; }

  // The values of the table; mappings as the bus begins with.
  void restore() {
    for (int slot = 0; slot < kSlots; ++slot) value_[slot] = entry(slot).standard;
    if (bus_ == Bus::ethercat)
      map_for_ethercat();
    else
      map_for_canopen();
  }

  static const Entry& entry(int slot) { return kEntries[static_cast<std::size_t>(slot)]; }
  // Slot of an entry that is there on this bus; -1.
  int find(std::uint16_t index, std::uint8_t sub) const {
    const int slot = find_slot(index, sub);
    return slot >= 0 && entry(slot).on(bus_) ? slot : -1;
  }

  std::int64_t at(int slot) const { return value_[slot]; }
  // A number by its place in the dictionary; 0 where it has no such entry.
  std::uint32_t number(std::uint16_t index, std::size_t sub) const {
    const int slot = find(index, static_cast<std::uint8_t>(sub));
    return slot < 0 ? 0 : static_cast<std::uint32_t>(value_[slot]);
  }
  template <std::uint16_t index, std::uint8_t sub = 0>
  std::int64_t get() const {
    return value_[kSlot<index, sub>];
  }
  // No check: for what the drive itself publishes.
  template <std::uint16_t index, std::uint8_t sub = 0>
  void set(std::int64_t value) {
    value_[kSlot<index, sub>] = value;
  }
  void set_at(int slot, std::int64_t value) { value_[slot] = value; }
  // Address of a value, little-endian, for copied process data.
  const std::byte* place(int slot) const {
    return reinterpret_cast<const std::byte*>(&value_[slot]);
  }

  // Show a text, which must outlive the values.
  void set_text(std::uint16_t index, const char* text) {
    for (Text& one : text_)
      if (one.index == index) one.text = text;
  }

  // Whether the mapping of process data is in use: on EtherCAT all of it, on CANopen that of PDOs
  // whose COB-ID is valid.
  bool mapping_locked = false;

  std::uint32_t read(std::uint16_t index, std::uint8_t sub, std::span<std::byte> out,
                     std::size_t& size) const {
    size = 0;
    const int slot = find(index, sub);
    if (slot < 0) return missing(index);
    const Entry& one = entry(slot);
    if (!one.readable()) return abort_code::write_only;
    const std::byte* from = place(slot);
    size = one.bits / 8U;
    if (!one.bits) {
      for (const Text& text : text_)
        if (text.index == index) from = reinterpret_cast<const std::byte*>(text.text);
      size = std::strlen(reinterpret_cast<const char*>(from));
    }
    if (out.size() < size) return abort_code::memory;
    std::memcpy(out.data(), from, size);
    return abort_code::none;
  }

  // Whether a write would be taken; the value as a number.
  std::uint32_t check(std::uint16_t index, std::uint8_t sub, std::span<const std::byte> in,
                      int& slot, std::int64_t& value) const {
    slot = find(index, sub);
    if (slot < 0) return missing(index);
    const Entry& one = entry(slot);
    if (!one.writable()) return abort_code::read_only;
    const std::size_t size = one.bits / 8U;
    if (in.size() > size) return abort_code::too_long;
    if (in.size() < size) return abort_code::too_short;
    value = number(one, in.data());
    return check_value(slot, value);
  }
  // Whether a writable entry may have a value of its type now.
  std::uint32_t check_value(int slot, std::int64_t value) const {
    const Entry& one = entry(slot);
    if (bus_ == Bus::canopen) {
      const std::uint32_t abort = check_communication(one, value, value_[slot]);
      if (abort) return abort;
    }
    constexpr std::int64_t not_finite = 0x7F800000;  // bits of a float that is infinite or NaN
    if (one.type == Type::real32 && (value & not_finite) == not_finite)
      return abort_code::out_of_range;
    if (one.fixed && value != value_[slot]) return abort_code::out_of_range;
    if (value > one.most) return abort_code::too_high;
    if (value < one.least) return abort_code::too_low;
    if (one.index >= 0x1600 && one.index < 0x1600 + dictionary::kMappings)
      return check_mapping(one, value, Pdo::rx);
    if (one.index >= 0x1A00 && one.index < 0x1A00 + dictionary::kMappings)
      return check_mapping(one, value, Pdo::tx);
    if (one.index == 0x1C12 || one.index == 0x1C13) return check_assignment(one, value);
    return abort_code::none;
  }
  // An entry's value from bytes.
  static std::int64_t number(const Entry& one, const std::byte* from) {
    std::uint64_t bits = 0;
    std::memcpy(&bits, from, one.bits / 8U);
    const int unused = 64 - one.bits;
    return is_signed(one.type) ? static_cast<std::int64_t>(bits << unused) >> unused
                               : static_cast<std::int64_t>(bits);
  }

  // Entries of a PDO (0x1600 ..., 0x1A00 ...). Returns their number.
  int mapping(std::uint16_t pdo, std::span<Mapped> out) const {
    const int first = find(pdo, 0);
    if (first < 0) return 0;
    int count = static_cast<int>(value_[first]);
    if (count > static_cast<int>(out.size())) count = static_cast<int>(out.size());
    for (int k = 0; k < count; ++k)
      out[static_cast<std::size_t>(k)] = mapped(value_[first + 1 + k]);
    return count;
  }
  // The PDOs that a sync manager carries (0x1C12, 0x1C13), one after the other, as one list.
  int process_data(std::uint16_t assignment, std::span<Mapped> out) const {
    const int first = find(assignment, 0);
    if (first < 0) return 0;
    int count = 0;
    for (int k = 1; k <= value_[first]; ++k)
      count += mapping(static_cast<std::uint16_t>(value_[first + k]),
                       out.subspan(static_cast<std::size_t>(count)));
    return count;
  }
  // All PDOs of a sync manager at once.
  static constexpr int kMostMapped = dictionary::kMappings * dictionary::kMappedObjects;

  void add_error(std::uint32_t error) {
    constexpr int first = kSlot<0x1003, 0>;
    for (int k = dictionary::kErrors; k > 1; --k) value_[first + k] = value_[first + k - 1];
    value_[first + 1] = error;
    if (value_[first] < dictionary::kErrors) ++value_[first];
  }
  void forget_errors() {
    for (int k = 0; k <= dictionary::kErrors; ++k) value_[kSlot<0x1003, 0> + k] = 0;
  }

 private:
  std::uint32_t missing(std::uint16_t index) const {
    return find(index, 0) < 0 ? abort_code::no_object : abort_code::no_sub;
  }

  // A mapping word: index, sub, bits. Index 0 and those of data types stand for gaps.
  Mapped mapped(std::int64_t word) const {
    const auto index = static_cast<std::uint16_t>(word >> 16);
    const auto sub = static_cast<std::uint8_t>(word >> 8);
    return {index < 8 ? -1 : find(index, sub), static_cast<int>(word & 0xff)};
  }
  std::uint32_t check_mapped(std::int64_t word, Pdo way) const {
    const auto index = static_cast<std::uint16_t>(word >> 16);
    const int bits = static_cast<int>(word & 0xff);
    if (index < 8) return bits % 8 == 0 && bits > 0 ? 0 : abort_code::not_mappable;
    const Mapped one = mapped(word);
    if (one.slot < 0) return missing(index);
    if (!maps(entry(one.slot).pdo, way) || entry(one.slot).bits != bits)
      return abort_code::not_mappable;
    return abort_code::none;
  }
  int longest_pdo() const { return bus_ == Bus::canopen ? 8 : kLongestPdo; }
  std::uint32_t check_communication(const Entry& one, std::int64_t value, std::int64_t now) const {
    if (!canopen::is_mapping(one.index)) return canopen::check(one, value, now);
    const int pdo = find_slot(static_cast<std::uint16_t>(one.index - 0x200), 1);
    const bool used = mapping_locked && !(value_[pdo] & canopen::kInvalid);
    return used ? abort_code::state : abort_code::none;
  }
  std::uint32_t check_mapping(const Entry& one, std::int64_t value, Pdo way) const {
    if (mapping_locked && bus_ == Bus::ethercat) return abort_code::state;
    const int first = find_slot(one.index, 0);
    if (one.sub) {
      if (value_[first])
        return bus_ == Bus::ethercat ? abort_code::sub0_not_zero : abort_code::state;
      return value ? check_mapped(value, way) : 0;
    }
    std::int64_t bits = 0;
    for (int k = 1; k <= value; ++k) {
      const std::uint32_t abort = check_mapped(value_[first + k], way);
      if (abort) return abort;
      bits += value_[first + k] & 0xff;
    }
    return bits > 8 * longest_pdo() ? abort_code::pdo_too_long : abort_code::none;
  }
  std::uint32_t check_assignment(const Entry& one, std::int64_t value) const {
    if (mapping_locked) return abort_code::state;
    const int first = find_slot(one.index, 0);
    const std::int64_t least = one.index == 0x1C12 ? 0x1600 : 0x1A00;
    const auto is_pdo = [&](std::int64_t pdo) {
      return pdo >= least && pdo < least + dictionary::kMappings;
    };
    if (one.sub) {
      if (value_[first]) return abort_code::sub0_not_zero;
      return value == 0 || is_pdo(value) ? abort_code::none : abort_code::out_of_range;
    }
    for (int k = 1; k <= value; ++k) {
      if (!is_pdo(value_[first + k])) return abort_code::out_of_range;
      for (int other = 1; other < k; ++other)  // the same one twice
        if (value_[first + k] == value_[first + other]) return abort_code::incompatible;
    }
    return abort_code::none;
  }

  void map(std::uint16_t pdo, std::initializer_list<std::uint32_t> words) {
    const int first = find_slot(pdo, 0);
    int count = 0;
    for (const std::uint32_t word : words) value_[first + ++count] = word;
    value_[first] = count;
  }
  void map_for_ethercat() {
    map(0x1600, {0x60400010, 0x607A0020, 0x60FF0020, 0x60710010, 0x60600008, 0x00000008});
    map(0x1601, {0x60400010, 0x607A0020});
    map(0x1602, {0x60400010, 0x60FF0020});
    map(0x1603, {0x60400010, 0x60710010});
    map(0x1A00, {0x60410010, 0x60640020, 0x606C0020, 0x60770010, 0x60610008, 0x00000008});
    map(0x1A01, {0x60410010, 0x60640020});
    map(0x1A02, {0x60410010, 0x60640020, 0x606C0020});
    map(0x1A03, {0x60410010, 0x60640020, 0x60770010});
  }
  void map_for_canopen() {
    map(0x1600, {0x60400010, 0x60600008});
    map(0x1601, {0x60400010, 0x607A0020});
    map(0x1602, {0x60400010, 0x60FF0020});
    map(0x1603, {0x60400010, 0x60710010});
    map(0x1A00, {0x60410010, 0x60610008});
    map(0x1A01, {0x60410010, 0x60640020});
    map(0x1A02, {0x60410010, 0x606C0020});
    map(0x1A03, {0x60410010, 0x60770010});
  }

  Bus bus_;
  std::int64_t value_[kSlots] = {};
  struct Text {
    std::uint16_t index;
    const char* text = "";
  };
  Text text_[4] = {{0x1008}, {0x1009}, {0x100A}, {0x2012}};
};

}  // namespace fieldbus
