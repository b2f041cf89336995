// The object dictionary of a drive: one table for EtherCAT and CANopen.
//
// Communication objects after CiA 301 and ETG.1000.6, those of the drive after CiA 402
// (IEC 61800-7-201); between them those that parts declare (declared.hpp). The table
// lists the objects; the values of one drive are in drive.hpp. Positions are in counts of the
// encoder at the motor, speeds in counts/s, torques in 0.1 % of the rated torque 0x6076.
#pragma once

#include <cstddef>
#include <cstdint>
#include <limits>
#include <span>

#include "abort_codes.hpp"
#include "declared.hpp"

namespace fieldbus {

// The dictionary's own error codes are those of 0x603F, see cia402.hpp.
namespace dictionary {

inline constexpr int kCapacity = 400;
inline constexpr int kMappings = 4;        // PDOs of each way
inline constexpr int kMappedObjects = 12;  // in a PDO
inline constexpr int kErrors = 8;          // that 0x1003 remembers

struct Table {
  Entry entry[kCapacity];
  int size = 0;

  // The entry added last.
  constexpr Entry& last() { return entry[size - 1]; }
  constexpr Table& add(std::uint16_t index, std::uint8_t sub, const char* name, Type type,
                       Access access, Pdo pdo = Pdo::none, const char* unit = "",
                       std::int64_t standard = 0) {
    Entry& one = entry[size++];
    one.index = index;
    one.sub = sub;
    one.object = one.name = name;
    one.type = type;
    one.bits = bits_of(type);
    one.access = access;
    one.pdo = pdo;
    one.unit = unit;
    one.standard = standard;
    if (type == Type::real64) {  // any bits
      one.least = std::numeric_limits<std::int64_t>::min();
      one.most = std::numeric_limits<std::int64_t>::max();
      return *this;
    }
    const int value_bits = one.bits ? one.bits : 1;
    one.least = is_signed(type) ? -(std::int64_t{1} << (value_bits - 1)) : 0;
    one.most = (std::int64_t{1} << (is_signed(type) ? value_bits - 1 : value_bits)) - 1;
    return *this;
  }
  constexpr Table& within(std::int64_t least, std::int64_t most) {
    last().least = least;
    last().most = most;
    return *this;
  }
  // A property of the machine: masters may write the value that it has.
  constexpr Table& fixed() {
    last().fixed = true;
    return *this;
  }
  constexpr Table& only(std::uint8_t buses) {
    last().buses = buses;
    return *this;
  }
  // Begin an array or record: its sub 0, which states how many there are.
  constexpr Table& begin(std::uint16_t index, Code code, const char* object, std::uint8_t subs,
                         Access access = Access::constant, std::uint8_t buses = kEveryBus) {
    add(index, 0, "Number of entries", Type::unsigned8, access, Pdo::none, "", subs)
        .within(0, subs)
        .only(buses);
    last().object = object;
    last().code = code;
    last().last_sub = subs;
    return *this;
  }
  // One more sub of the object begun last.
  constexpr Table& sub(const char* name, Type type, Access access, Pdo pdo = Pdo::none,
                       const char* unit = "", std::int64_t standard = 0) {
    const Entry before = last();
    add(before.index, static_cast<std::uint8_t>(before.sub + 1), name, type, access, pdo, unit,
        standard)
        .only(before.buses);
    last().object = before.object;
    last().code = before.code;
    last().last_sub = before.last_sub;
    return *this;
  }
};

constexpr Table make_table() {
  using enum Type;
  constexpr Access c = Access::constant, ro = Access::read, rw = Access::both;
  constexpr Pdo rx = Pdo::rx, tx = Pdo::tx, no = Pdo::none;
  constexpr std::int64_t largest = std::numeric_limits<std::int32_t>::max();
  constexpr const char* object_names[kMappedObjects] = {
      "Object 1", "Object 2", "Object 3", "Object 4",  "Object 5",  "Object 6",
      "Object 7", "Object 8", "Object 9", "Object 10", "Object 11", "Object 12"};
  constexpr const char* error_names[kErrors] = {"Error 1", "Error 2", "Error 3", "Error 4",
                                                "Error 5", "Error 6", "Error 7", "Error 8"};
  constexpr const char* pdo_names[kMappings] = {"PDO 1", "PDO 2", "PDO 3", "PDO 4"};
  constexpr const char* mapping[2][kMappings] = {
      {"RPDO 1 mapping", "RPDO 2 mapping", "RPDO 3 mapping", "RPDO 4 mapping"},
      {"TPDO 1 mapping", "TPDO 2 mapping", "TPDO 3 mapping", "TPDO 4 mapping"}};
  constexpr const char* communication[2][kMappings] = {
      {"RPDO 1 communication", "RPDO 2 communication", "RPDO 3 communication",
       "RPDO 4 communication"},
      {"TPDO 1 communication", "TPDO 2 communication", "TPDO 3 communication",
       "TPDO 4 communication"}};
  Table t;

  // ------------------------------------------------------------------ communication, CiA 301
  t.add(0x1000, 0, "Device type", unsigned32, c, no, "", 0x00020192);  // servo drive, CiA 402
  t.add(0x1001, 0, "Error register", unsigned8, ro, tx);
  t.begin(0x1003, Code::array, "Pre-defined error field", kErrors, rw);
  t.last().standard = 0;
  for (const char* name : error_names) t.sub(name, unsigned32, ro);
  t.add(0x1005, 0, "COB-ID SYNC", unsigned32, rw, no, "", 0x80).only(kCanopen);
  t.add(0x1006, 0, "Communication cycle period", unsigned32, rw, no, "us").only(kCanopen);
  t.add(0x1007, 0, "Synchronous window length", unsigned32, rw, no, "us").only(kCanopen);
  t.add(0x1008, 0, "Manufacturer device name", visible_string, c);
  t.add(0x1009, 0, "Manufacturer hardware version", visible_string, c);
  t.add(0x100A, 0, "Manufacturer software version", visible_string, c);
  t.add(0x100C, 0, "Guard time", unsigned16, rw, no, "ms").only(kCanopen);
  t.add(0x100D, 0, "Life time factor", unsigned8, rw).only(kCanopen);
  t.begin(0x1010, Code::array, "Store parameters", 1);
  t.sub("Store all parameters", unsigned32, rw);
  t.begin(0x1011, Code::array, "Restore default parameters", 1);
  t.sub("Restore all default parameters", unsigned32, rw, no, "", 1);
  t.add(0x1014, 0, "COB-ID EMCY", unsigned32, rw, no, "", 0x80).only(kCanopen);
  t.begin(0x1016, Code::array, "Consumer heartbeat time", 1, c, kCanopen);
  t.sub("Consumer heartbeat time 1", unsigned32, rw, no, "ms");
  t.add(0x1017, 0, "Producer heartbeat time", unsigned16, rw, no, "ms").only(kCanopen);
  t.begin(0x1018, Code::record, "Identity object", 4);
  t.sub("Vendor ID", unsigned32, c, no, "", 0x41524D45);
  t.sub("Product code", unsigned32, c, no, "", 0x00000402);
  t.sub("Revision number", unsigned32, c, no, "", 0x00010000);
  t.sub("Serial number", unsigned32, ro);
  t.begin(0x1029, Code::array, "Error behaviour", 1, c, kCanopen);
  t.sub("Communication error", unsigned8, rw).within(0, 2);
  t.begin(0x10F1, Code::record, "Error settings", 2, c, kEthercat);
  t.sub("Local error reaction", unsigned32, rw, no, "", 1);
  t.sub("Sync error counter limit", unsigned16, rw, no, "", 4);
  t.begin(0x1200, Code::record, "SDO server parameter", 2, c, kCanopen);
  t.sub("COB-ID client to server", unsigned32, ro, no, "", 0x600);
  t.sub("COB-ID server to client", unsigned32, ro, no, "", 0x580);
  for (const bool sends : {false, true}) {
    const int first = sends ? 0x1800 : 0x1400, identifier = sends ? 0x180 : 0x200;
    for (int k = 0; k < kMappings; ++k) {
      t.begin(static_cast<std::uint16_t>(first + k), Code::record, communication[sends][k], 5, c,
              kCanopen);
      t.sub("COB-ID", unsigned32, rw, no, "", identifier + 0x100 * k);
      t.sub("Transmission type", unsigned8, rw, no, "", 255);
      t.sub("Inhibit time", unsigned16, rw, no, "100 us");
      t.sub("Reserved", unsigned8, rw);
      t.sub("Event timer", unsigned16, rw, no, "ms");
    }
    for (int k = 0; k < kMappings; ++k) {
      t.begin(static_cast<std::uint16_t>(first + 0x200 + k), Code::record, mapping[sends][k],
              kMappedObjects, rw);
      t.last().standard = 0;
      for (const char* name : object_names) t.sub(name, unsigned32, rw);
    }
  }
  t.begin(0x1C00, Code::array, "Sync manager communication type", 4, c, kEthercat);
  t.sub("Mailbox out", unsigned8, c, no, "", 1);
  t.sub("Mailbox in", unsigned8, c, no, "", 2);
  t.sub("Process data out", unsigned8, c, no, "", 3);
  t.sub("Process data in", unsigned8, c, no, "", 4);
  t.begin(0x1C12, Code::array, "Sync manager 2 assignment", kMappings, rw, kEthercat);
  t.last().standard = 1;
  for (int k = 0; k < kMappings; ++k) t.sub(pdo_names[k], unsigned16, rw, no, "", k ? 0 : 0x1600);
  t.begin(0x1C13, Code::array, "Sync manager 3 assignment", kMappings, rw, kEthercat);
  t.last().standard = 1;
  for (int k = 0; k < kMappings; ++k) t.sub(pdo_names[k], unsigned16, rw, no, "", k ? 0 : 0x1A00);
  for (int k = 0; k < 2; ++k) {
    t.begin(static_cast<std::uint16_t>(0x1C32 + k), Code::record,
            k ? "Sync manager 3 parameter" : "Sync manager 2 parameter", 12, c, kEthercat);
    t.sub("Synchronization type", unsigned16, rw, no, "", k ? 0x22 : 1);
    t.sub("Cycle time", unsigned32, rw, no, "ns");
    t.sub("Shift time", unsigned32, rw, no, "ns");
    t.sub("Synchronization types supported", unsigned16, ro, no, "", 7);
    t.sub("Minimum cycle time", unsigned32, ro, no, "ns");
    t.sub("Calc and copy time", unsigned32, ro, no, "ns");
    t.sub("Minimum delay time", unsigned32, ro, no, "ns");
    t.sub("Get cycle time", unsigned16, rw);
    t.sub("Delay time", unsigned32, ro, no, "ns");
    t.sub("Sync0 cycle time", unsigned32, rw, no, "ns");
    t.sub("SM event missed counter", unsigned16, ro);
    t.sub("Cycle exceeded counter", unsigned16, ro);
  }

  // ------------------------------------------------------------------------ this drive's own
  t.add(0x2001, 0, "Velocity feed-forward in position modes", unsigned16, rw, no, "0.1 %", 1000)
      .within(0, 1000);
  t.add(0x2002, 0, "Smoothing time of the feed-forward", unsigned16, rw, no, "0.1 ms", 40)
      .within(0, 10000);
  t.add(0x2003, 0, "Torque of a stop in homing", unsigned16, rw, no, "0.1 %", 300).within(1, 1000);
  t.add(0x2004, 0, "Brake closed", unsigned8, ro, tx);
  t.add(0x2005, 0, "Motor current", integer32, ro, tx, "mA");
  t.add(0x2006, 0, "Motor command", integer32, ro, tx, "mV, mA");
  t.add(0x2007, 0, "Unit of the velocity windows 0x606D and 0x606F", unsigned32, ro, no,
        "counts/s");
  t.add(0x2008, 0, "Unit of accelerations", unsigned32, ro, no, "counts/s2");
  t.add(0x2010, 0, "Faults of the scene", unsigned16, ro);
  t.add(0x2011, 0, "Number of the chosen fault", unsigned16, rw);
  t.add(0x2012, 0, "Name of the chosen fault", visible_string, ro);
  t.add(0x2013, 0, "Magnitude of the chosen fault", real64, rw);

  // --------------------------------------------------------------------- what parts declare
  for (std::size_t k = 0, j = 0; k < std::size(kTaken) || j < std::size(kReported);) {
    const bool first = j == std::size(kReported) ||
                       (k < std::size(kTaken) && kTaken[k].index < kReported[j].index);
    if (first) {
      const Taken& one = kTaken[k++];
      t.add(one.index, 0, one.name, real32, rw, rx, one.unit);
      continue;
    }
    const Reported& one = kReported[j++];
    if (!one.per_unit) {
      t.add(one.index, 0, one.name, one.type, ro, tx, one.unit);
      continue;
    }
    t.begin(one.index, Code::array, one.name, kUnitValues);
    for (const char* name : kUnitValueNames) t.sub(name, one.type, ro, tx, one.unit);
  }

  // ------------------------------------------------------------------------ the drive, CiA 402
  t.add(0x6007, 0, "Abort connection option code", integer16, rw, no, "", 1).within(0, 3);
  t.add(0x603F, 0, "Error code", unsigned16, ro, tx);
  t.add(0x6040, 0, "Controlword", unsigned16, rw, rx);
  t.add(0x6041, 0, "Statusword", unsigned16, ro, tx);
  t.add(0x605A, 0, "Quick stop option code", integer16, rw, no, "", 2).within(0, 8);
  t.add(0x605B, 0, "Shutdown option code", integer16, rw, no, "", 0).within(0, 1);
  t.add(0x605C, 0, "Disable operation option code", integer16, rw, no, "", 1).within(0, 1);
  t.add(0x605D, 0, "Halt option code", integer16, rw, no, "", 1).within(1, 3);
  t.add(0x605E, 0, "Fault reaction option code", integer16, rw, no, "", 2).within(0, 3);
  t.add(0x6060, 0, "Modes of operation", integer8, rw, rx, "", 0).within(0, 10);
  t.add(0x6061, 0, "Modes of operation display", integer8, ro, tx);
  t.add(0x6062, 0, "Position demand value", integer32, ro, tx, "counts");
  t.add(0x6063, 0, "Position actual internal value", integer32, ro, tx, "counts");
  t.add(0x6064, 0, "Position actual value", integer32, ro, tx, "counts");
  t.add(0x6065, 0, "Following error window", unsigned32, rw, rx, "counts");
  t.add(0x6066, 0, "Following error time out", unsigned16, rw, rx, "ms", 10);
  t.add(0x6067, 0, "Position window", unsigned32, rw, rx, "counts");
  t.add(0x6068, 0, "Position window time", unsigned16, rw, rx, "ms", 10);
  t.add(0x6069, 0, "Velocity sensor actual value", integer32, ro, tx, "counts/s");
  t.add(0x606B, 0, "Velocity demand value", integer32, ro, tx, "counts/s");
  t.add(0x606C, 0, "Velocity actual value", integer32, ro, tx, "counts/s");
  t.add(0x606D, 0, "Velocity window", unsigned16, rw, rx, "of 0x2007", 1000);
  t.add(0x606E, 0, "Velocity window time", unsigned16, rw, rx, "ms", 10);
  t.add(0x606F, 0, "Velocity threshold", unsigned16, rw, rx, "of 0x2007", 1000);
  t.add(0x6070, 0, "Velocity threshold time", unsigned16, rw, rx, "ms", 10);
  t.add(0x6071, 0, "Target torque", integer16, rw, rx, "0.1 %");
  t.add(0x6072, 0, "Max torque", unsigned16, rw, rx, "0.1 %", 1000);
  t.add(0x6074, 0, "Torque demand", integer16, ro, tx, "0.1 %");
  t.add(0x6075, 0, "Motor rated current", unsigned32, rw, no, "mA").fixed();
  t.add(0x6076, 0, "Motor rated torque", unsigned32, rw, no, "mN m").fixed();
  t.add(0x6077, 0, "Torque actual value", integer16, ro, tx, "0.1 %");
  t.add(0x6078, 0, "Current actual value", integer16, ro, tx, "0.1 %");
  t.add(0x6079, 0, "DC link circuit voltage", unsigned32, ro, tx, "mV");
  t.add(0x607A, 0, "Target position", integer32, rw, rx, "counts");
  t.begin(0x607B, Code::array, "Position range limit", 2);
  t.sub("Min position range limit", integer32, rw, no, "counts", -largest - 1).fixed();
  t.sub("Max position range limit", integer32, rw, no, "counts", largest).fixed();
  t.add(0x607C, 0, "Home offset", integer32, rw, no, "counts");
  t.begin(0x607D, Code::array, "Software position limit", 2);
  t.sub("Min position limit", integer32, rw, no, "counts", -largest - 1);
  t.sub("Max position limit", integer32, rw, no, "counts", largest);
  t.add(0x607E, 0, "Polarity", unsigned8, rw).within(0, 0);
  t.add(0x607F, 0, "Max profile velocity", unsigned32, rw, rx, "counts/s").within(0, largest);
  t.add(0x6080, 0, "Max motor speed", unsigned32, rw, rx, "rpm");
  t.add(0x6081, 0, "Profile velocity", unsigned32, rw, rx, "counts/s").within(1, largest);
  t.add(0x6082, 0, "End velocity", unsigned32, rw, no, "counts/s").within(0, 0);
  t.add(0x6083, 0, "Profile acceleration", unsigned32, rw, rx, "of 0x2008").within(1, 4294967295);
  t.add(0x6084, 0, "Profile deceleration", unsigned32, rw, rx, "of 0x2008").within(1, 4294967295);
  t.add(0x6085, 0, "Quick stop deceleration", unsigned32, rw, rx, "of 0x2008")
      .within(1, 4294967295);
  t.add(0x6086, 0, "Motion profile type", integer16, rw, no).within(0, 0);
  t.add(0x6087, 0, "Torque slope", unsigned32, rw, rx, "0.1 %/s", 10000).within(1, 4294967295);
  t.begin(0x608F, Code::array, "Position encoder resolution", 2);
  t.sub("Encoder increments", unsigned32, rw, no, "counts").fixed();
  t.sub("Motor revolutions", unsigned32, rw, no, "turns", 1).fixed();
  t.begin(0x6091, Code::array, "Gear ratio", 2);
  t.sub("Motor revolutions", unsigned32, rw, no, "turns", 1).fixed();
  t.sub("Shaft revolutions", unsigned32, rw, no, "turns", 1).fixed();
  t.begin(0x6092, Code::array, "Feed constant", 2);
  t.sub("Feed", unsigned32, rw, no, "counts").fixed();
  t.sub("Shaft revolutions", unsigned32, rw, no, "turns", 1).fixed();
  t.add(0x6098, 0, "Homing method", integer8, rw, rx, "", 37);
  t.begin(0x6099, Code::array, "Homing speeds", 2);
  t.sub("Speed during search for switch", unsigned32, rw, rx, "counts/s").within(1, largest);
  t.sub("Speed during search for zero", unsigned32, rw, rx, "counts/s").within(1, largest);
  t.add(0x609A, 0, "Homing acceleration", unsigned32, rw, rx, "of 0x2008").within(1, 4294967295);
  t.add(0x60B0, 0, "Position offset", integer32, rw, rx, "counts");
  t.add(0x60B1, 0, "Velocity offset", integer32, rw, rx, "counts/s");
  t.add(0x60B2, 0, "Torque offset", integer16, rw, rx, "0.1 %");
  t.add(0x60B8, 0, "Touch probe function", unsigned16, rw, rx);
  t.add(0x60B9, 0, "Touch probe status", unsigned16, ro, tx);
  t.add(0x60BA, 0, "Touch probe 1 positive edge", integer32, ro, tx, "counts");
  t.add(0x60BB, 0, "Touch probe 1 negative edge", integer32, ro, tx, "counts");
  t.add(0x60BC, 0, "Touch probe 2 positive edge", integer32, ro, tx, "counts");
  t.add(0x60BD, 0, "Touch probe 2 negative edge", integer32, ro, tx, "counts");
  t.begin(0x60C2, Code::record, "Interpolation time period", 2);
  t.sub("Interpolation time period value", unsigned8, rw);
  t.sub("Interpolation time index", integer8, rw, no, "", -3).within(-6, 0);
  t.add(0x60C5, 0, "Max acceleration", unsigned32, rw, rx, "of 0x2008").within(1, 4294967295);
  t.add(0x60C6, 0, "Max deceleration", unsigned32, rw, rx, "of 0x2008").within(1, 4294967295);
  t.add(0x60E0, 0, "Positive torque limit", unsigned16, rw, rx, "0.1 %", 1000);
  t.add(0x60E1, 0, "Negative torque limit", unsigned16, rw, rx, "0.1 %", 1000);
  t.begin(0x60E3, Code::array, "Supported homing methods", 10);
  for (const char* name : {"Method 1", "Method 2", "Method 3", "Method 4", "Method 5", "Method 6",
                           "Method 7", "Method 8", "Method 9", "Method 10"})
    t.sub(name, integer8, ro);
  t.add(0x60F2, 0, "Positioning option code", unsigned16, rw).within(0, 0);
  t.add(0x60F4, 0, "Following error actual value", integer32, ro, tx, "counts");
  t.add(0x60FC, 0, "Position demand internal value", integer32, ro, tx, "counts");
  t.add(0x60FD, 0, "Digital inputs", unsigned32, ro, tx);
  t.begin(0x60FE, Code::array, "Digital outputs", 2);
  t.sub("Physical outputs", unsigned32, rw, rx);
  t.sub("Bit mask", unsigned32, rw);
  t.add(0x60FF, 0, "Target velocity", integer32, rw, rx, "counts/s");
  t.add(0x6402, 0, "Motor type", unsigned16, rw).fixed();
  t.add(0x6502, 0, "Supported drive modes", unsigned32, ro, no, "", 0x3AD);
  return t;
}

inline constexpr Table kTable = make_table();

constexpr bool is_ascending() {
  for (int k = 1; k < kTable.size; ++k) {
    const Entry &one = kTable.entry[k - 1], &next = kTable.entry[k];
    if (one.index > next.index || (one.index == next.index && one.sub + 1 != next.sub))
      return false;
  }
  return kTable.size <= kCapacity;
}
static_assert(is_ascending(), "entries stand in the order of their indices, subs without a gap");

}  // namespace dictionary

// All entries, ascending. Their places in this table are their slots.
inline constexpr std::span<const Entry> kEntries{dictionary::kTable.entry,
                                                 static_cast<std::size_t>(dictionary::kTable.size)};
inline constexpr int kSlots = dictionary::kTable.size;

// The first slot whose (index, sub) is not below these.
constexpr int find_slot_from(std::uint16_t index, std::uint8_t sub) {
  int low = 0, high = kSlots;
  while (low < high) {
    const int middle = (low + high) / 2;
    const Entry& one = kEntries[static_cast<std::size_t>(middle)];
    const bool below = one.index < index || (one.index == index && one.sub < sub);
    if (below)
      low = middle + 1;
    else
      high = middle;
  }
  return low;
}
// The slot of an entry; -1: not in the dictionary.
constexpr int find_slot(std::uint16_t index, std::uint8_t sub) {
  const int slot = find_slot_from(index, sub);
  if (slot == kSlots) return -1;
  const Entry& one = kEntries[static_cast<std::size_t>(slot)];
  return one.index == index && one.sub == sub ? slot : -1;
}
// The same for an entry that is known to be there when this is compiled.
template <std::uint16_t index, std::uint8_t sub = 0>
inline constexpr int kSlot = [] {
  static_assert(find_slot(index, sub) >= 0, "the dictionary has this entry");
  return find_slot(index, sub);
}();

}  // namespace fieldbus
