// Slave information interface: the EEPROM that describes a slave to its master (ETG.2010), and the
// registers from 0x0500 on through which it is read and written.
#pragma once

#include <string>
#include <vector>

#include "../values.hpp"
#include "registers.hpp"

namespace ethercat {

// Addresses of a slave's mailboxes and buffers of process data.
namespace area {
constexpr std::uint16_t kMailbox = 256;  // bytes of each
constexpr std::uint16_t kMailboxOut = 0x1000, kMailboxIn = 0x1100, kOutputs = 0x1200,
                        kInputs = 0x1500;
constexpr std::uint8_t kMailboxOutControl = 0x26, kMailboxInControl = 0x22, kOutputsControl = 0x64,
                       kInputsControl = 0x20;
}  // namespace area

// Content of a drive's EEPROM; its process data objects are those of its first mapping.
inline std::vector<std::uint8_t> make_sii_image(const fieldbus::Values& of) {
  std::vector<std::uint8_t> out(0x80, 0);
  const auto put = [&out](std::size_t word, std::uint16_t value) { put16(&out[2 * word], value); };
  put(0x00, 0x0005);  // a process data interface of a microcontroller, as at register 0x0140
  put32(&out[2 * 0x08], of.number(0x1018, 1));
  put32(&out[2 * 0x0a], of.number(0x1018, 2));
  put32(&out[2 * 0x0c], of.number(0x1018, 3));
  put32(&out[2 * 0x0e], of.number(0x1018, 4));
  put(0x18, area::kMailboxOut);
  put(0x19, area::kMailbox);
  put(0x1a, area::kMailboxIn);
  put(0x1b, area::kMailbox);
  put(0x1c, 0x0004);  // CoE
  put(0x3e, 15);      // 2 KiB, in Kibit less one
  put(0x3f, 1);       // version

  std::vector<std::string> strings;
  const auto word_of = [&strings](const std::string& text) {
    if (text.empty()) return std::uint8_t{0};
    for (std::size_t k = 0; k < strings.size(); ++k)
      if (strings[k] == text) return static_cast<std::uint8_t>(k + 1);
    strings.push_back(text.substr(0, 255));
    return static_cast<std::uint8_t>(strings.size());
  };
  std::vector<std::uint8_t> categories;
  const auto category = [&categories](std::uint16_t kind, std::vector<std::uint8_t> body) {
    if (body.size() % 2) body.push_back(0);
    std::uint8_t head[4];
    put16(head, kind);
    put16(head + 2, static_cast<std::uint16_t>(body.size() / 2));
    categories.insert(categories.end(), head, head + 4);
    categories.insert(categories.end(), body.begin(), body.end());
  };

  std::vector<std::uint8_t> general(32, 0);
  const std::uint8_t device =
      word_of("arm_emulator drive");  // first, where some masters look for it
  general[0] = word_of("Servo drives");
  general[2] = general[3] = device;  // masters show the order code or the name
  general[5] =
      0x2f;        // CoE: SDO, SDO information, PDO assignment and configuration, complete access
  general[9] = 1;  // axes after CiA 402
  put16(&general[0x10], 0x0011);  // ports 0 and 1: MII
  category(30, general);
  category(40, {1, 2, 3, 0});  // FMMUs: outputs, inputs, state of the mailbox
  std::vector<std::uint8_t> managers;
  const auto manager = [&managers](std::uint16_t start, std::size_t size, std::uint8_t control,
                                   std::uint8_t enable, std::uint8_t use) {
    std::uint8_t one[8] = {};
    put16(one, start);
    put16(one + 2, static_cast<std::uint16_t>(size));
    one[4] = control;
    one[6] = enable;
    one[7] = use;
    managers.insert(managers.end(), one, one + 8);
  };
  const auto bytes = [&of](std::uint16_t assignment) {
    fieldbus::Mapped items[fieldbus::Values::kMostMapped];
    std::size_t bits = 0;
    for (int k = of.process_data(assignment, items); k > 0; --k) bits += items[k - 1].bits;
    return bits / 8;
  };
  manager(area::kMailboxOut, area::kMailbox, area::kMailboxOutControl, 1, 1);
  manager(area::kMailboxIn, area::kMailbox, area::kMailboxInControl, 1, 2);
  manager(area::kOutputs, bytes(0x1c12), area::kOutputsControl, 1, 3);
  manager(area::kInputs, bytes(0x1c13), area::kInputsControl, 1, 4);
  category(41, managers);
  for (const bool inputs : {true, false}) {  // transmitted, received
    const std::uint16_t from = inputs ? 0x1a00 : 0x1600, assignment = inputs ? 0x1c13 : 0x1c12;
    std::vector<std::uint8_t> body;
    for (int k = 0; k < fieldbus::dictionary::kMappings; ++k) {
      const auto index = static_cast<std::uint16_t>(from + k);
      const std::size_t count = of.number(index, 0);
      if (count == 0) continue;
      bool assigned = false;
      for (std::size_t one = of.number(assignment, 0); one > 0; --one)
        assigned = assigned || of.number(assignment, one) == index;
      std::uint8_t head[8] = {};
      put16(head, index);
      head[2] = static_cast<std::uint8_t>(count);
      head[3] = !assigned ? 0xff : inputs ? 3 : 2;
      head[5] = word_of(fieldbus::Values::entry(of.find(index, 0)).object);
      body.insert(body.end(), head, head + 8);
      for (std::size_t sub = 1; sub <= count; ++sub) {
        const std::uint32_t mapped = of.number(index, sub);
        const auto at = static_cast<std::uint16_t>(mapped >> 16);
        const int slot = of.find(at, static_cast<std::uint8_t>(mapped >> 8));
        std::uint8_t one[8] = {};
        put16(one, at);
        one[2] = static_cast<std::uint8_t>(mapped >> 8);
        if (slot >= 0) {
          const fieldbus::Entry& entry = fieldbus::Values::entry(slot);
          one[3] = word_of(entry.name);
          one[4] = static_cast<std::uint8_t>(entry.type);
        }
        one[5] = static_cast<std::uint8_t>(mapped);
        body.insert(body.end(), one, one + 8);
      }
    }
    if (!body.empty()) category(inputs ? 50 : 51, body);
  }
  std::vector<std::uint8_t> clocks(48, 0);  // free run, and SYNC0
  clocks[0x12] = word_of("FreeRun");
  put16(&clocks[24 + 0x0e], 0x0300);  // what 0x0980 is to hold
  put16(&clocks[24 + 0x10], 1);       // SYNC0's cycle is that of the process data
  clocks[24 + 0x12] = word_of("DC SYNC0");
  category(60, clocks);

  std::vector<std::uint8_t> words = {static_cast<std::uint8_t>(strings.size())};
  for (const std::string& text : strings) {
    words.push_back(static_cast<std::uint8_t>(text.size()));
    words.insert(words.end(), text.begin(), text.end());
  }
  std::vector<std::uint8_t> rest;
  rest.swap(categories);
  category(10, words);
  out.insert(out.end(), categories.begin(), categories.end());
  out.insert(out.end(), rest.begin(), rest.end());
  out.push_back(0xff);
  out.push_back(0xff);
  out.resize(std::max<std::size_t>(out.size(), 2048), 0xff);

  std::uint8_t crc = 0xff;  // x^8 + x^2 + x + 1 over the words before
  for (std::size_t k = 0; k < 14; ++k) {
    crc = static_cast<std::uint8_t>(crc ^ out[k]);
    for (int bit = 0; bit < 8; ++bit)
      crc = static_cast<std::uint8_t>(crc & 0x80 ? (crc << 1) ^ 0x07 : crc << 1);
  }
  put(0x07, crc);
  return out;
}

class Sii {
 public:
  Sii(Memory& memory, std::vector<std::uint8_t> contents)
      : memory_(memory), image_(std::move(contents)) {
    reload();
  }

  // As after switching on.
  void reload() {
    memory_.fill(reg::kEeprom, 16);
    memory_.put16(kControl, kEightBytes | kTwoAddressBytes);
    memory_.put16(reg::kPdi, word(0));
    memory_.put16(reg::kAlias, word(4));
  }

  // The master has written to the registers: carry out the command that may be among it.
  void handle_write(std::size_t address, std::size_t size) {
    if (!is_overlapping(address, size, kControl, 2)) return;
    const std::uint16_t control = memory_.get16(kControl);
    const unsigned command = (control >> 8) & 7u;
    const std::uint32_t at = memory_.get32(kAddress);
    std::uint16_t status = kEightBytes | kTwoAddressBytes;
    const bool ours = memory_.get8(reg::kEeprom) & 1;  // the drive has the EEPROM
    if (ours) {
      if (command != 0) status |= kRefused;
    } else if (command == 1) {
      for (std::uint32_t k = 0; k < 4; ++k)
        memory_.put16(kData + 2 * k, word(std::uint64_t{at} + k));
    } else if (command == 2) {
      if (!(control & 1))
        status |= kNotEnabled;
      else if (at < image_.size() / 2)
        put16(&image_[2 * at], memory_.get16(kData));
      else
        status |= kRefused;
    } else if (command == 4) {
      memory_.put16(reg::kAlias, word(4));
    } else if (command != 0) {
      status |= kRefused;
    }
    memory_.put16(kControl, status);
  }

 private:
  static constexpr std::size_t kControl = 0x0502, kAddress = 0x0504, kData = 0x0508;
  static constexpr std::uint16_t kEightBytes = 0x0040, kTwoAddressBytes = 0x0080, kRefused = 0x2000,
                                 kNotEnabled = 0x4000;

  std::uint16_t word(std::uint64_t at) const {
    return at < image_.size() / 2 ? get16(&image_[static_cast<std::size_t>(2 * at)]) : 0xffff;
  }

  Memory& memory_;
  std::vector<std::uint8_t> image_;
};

}  // namespace ethercat
