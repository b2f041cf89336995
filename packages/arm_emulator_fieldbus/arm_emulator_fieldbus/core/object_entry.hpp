// An entry of an object dictionary: type, access, process data, as CiA 301 has them.
#pragma once

#include <cstdint>

namespace fieldbus {

// Data types, by their index in CiA 301.
enum class Type : std::uint16_t {
  boolean = 0x01,
  integer8 = 0x02,
  integer16 = 0x03,
  integer32 = 0x04,
  unsigned8 = 0x05,
  unsigned16 = 0x06,
  unsigned32 = 0x07,
  real32 = 0x08,
  visible_string = 0x09,
  real64 = 0x11,
};
constexpr std::uint16_t bits_of(Type type) {
  switch (type) {
    case Type::boolean:
      return 1;
    case Type::integer8:
    case Type::unsigned8:
      return 8;
    case Type::integer16:
    case Type::unsigned16:
      return 16;
    case Type::integer32:
    case Type::unsigned32:
    case Type::real32:
      return 32;
    case Type::real64:
      return 64;
    case Type::visible_string:
      break;
  }
  return 0;  // as long as the text is
}
constexpr bool is_signed(Type type) {
  return type == Type::integer8 || type == Type::integer16 || type == Type::integer32;
}

enum class Access : std::uint8_t { constant, read, write, both };

// Whether it may be mapped into process data: rx is what the drive receives.
enum class Pdo : std::uint8_t { none = 0, rx = 1, tx = 2, both = 3 };
constexpr bool maps(Pdo pdo, Pdo way) {
  return (static_cast<int>(pdo) & static_cast<int>(way)) != 0;
}

enum class Code : std::uint8_t { variable = 7, array = 8, record = 9 };

// On which bus an object is there.
enum class Bus : std::uint8_t { ethercat = 1, canopen = 2 };
inline constexpr std::uint8_t kEthercat = 1, kCanopen = 2, kEveryBus = 3;

// One entry. `standard`, `least` and `most` are those of the type's range unless stated; initial
// values of a scene's drive may differ, and are in Drive.
struct Entry {
  std::uint16_t index = 0;
  std::uint8_t sub = 0;
  std::uint8_t buses = kEveryBus;
  Type type = Type::unsigned32;
  std::uint16_t bits = 32;  // 0: text
  Access access = Access::read;
  Pdo pdo = Pdo::none;
  Code code = Code::variable;  // of its object
  std::uint8_t last_sub = 0;   // of its object
  const char* object = "";     // name of the object
  const char* name = "";       // name of the entry
  const char* unit = "";
  std::int64_t standard = 0, least = 0, most = 0;
  bool fixed = false;  // a write succeeds with the present value alone

  constexpr bool readable() const { return access != Access::write; }
  constexpr bool writable() const { return access == Access::write || access == Access::both; }
  constexpr bool on(Bus bus) const { return (buses & static_cast<std::uint8_t>(bus)) != 0; }
};

}  // namespace fieldbus
