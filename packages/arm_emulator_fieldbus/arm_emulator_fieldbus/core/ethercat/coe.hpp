// CANopen over EtherCAT (ETG.1000.6, section 5.6): a master reads and writes a drive's object
// dictionary (SDO), lists it (SDO information), and receives emergencies.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "../canopen/sdo_server.hpp"
#include "frame.hpp"

namespace ethercat {

namespace abort_code = fieldbus::abort_code;
using fieldbus::Bytes, fieldbus::Code, fieldbus::Drive, fieldbus::Entry, fieldbus::Pdo;

// Details of a mailbox error, ETG.1000.4, table 30.
enum class MailboxError : std::uint16_t {
  none = 0,
  protocol = 2,
  service = 4,
  too_short = 6,
  size = 8
};

class Coe {
 public:
  explicit Coe(Drive& drive)
      : dictionary_(drive), server_(drive, fieldbus::SdoServer::Carrier::mailbox) {}

  // Discard a transfer in progress.
  void begin() { server_.begin(); }

  // Serve a request: CoE header and what follows it. `room`: how long a reply may be. Replies are
  // appended to `out`.
  MailboxError serve(std::span<const std::uint8_t> request, std::size_t room,
                     std::vector<Bytes>& out) {
    if (request.size() < 2) return MailboxError::too_short;
    const int service = request[1] >> 4;
    if (service == kSdoRequest) {
      if (request.size() < 10) return MailboxError::too_short;
      std::vector<Bytes> replies;
      server_.answer(request.subspan(2), room - 2, replies);
      for (const Bytes& one : replies)
        out.push_back(
            add_header(fieldbus::SdoServer::is_abort(one) ? kSdoRequest : kSdoResponse, one));
      return MailboxError::none;
    }
    if (service == kSdoInformation) {
      if (request.size() < 6) return MailboxError::too_short;
      const std::uint32_t abort = information(request.subspan(2), room - 2, out);
      if (abort != 0) {
        Bytes error = {kInformationError, 0, 0, 0, 0, 0, 0, 0};
        put32(&error[4], abort);
        out.push_back(add_header(kSdoInformation, error));
      }
      return MailboxError::none;
    }
    return MailboxError::service;
  }

  // The message that reports an error to a master (0x603F, 0x1001).
  static Bytes make_emergency(std::uint16_t code, std::uint8_t error_register) {
    Bytes body(8, 0);
    put16(&body[0], code);
    body[2] = error_register;
    return add_header(kEmergency, body);
  }

 private:
  static constexpr std::uint8_t kEmergency = 1, kSdoRequest = 2, kSdoResponse = 3,
                                kSdoInformation = 8, kInformationError = 7;

  static Bytes add_header(std::uint8_t service, const Bytes& body) {
    Bytes out = {0, static_cast<std::uint8_t>(service << 4)};
    out.insert(out.end(), body.begin(), body.end());
    return out;
  }

  std::uint32_t information(std::span<const std::uint8_t> request, std::size_t room,
                            std::vector<Bytes>& out) const {
    const std::span<const std::uint8_t> data = request.subspan(4);
    switch (request[0] & 0x7f) {
      case 1:
        return data.size() < 2 ? abort_code::command : list(get16(data.data()), room, out);
      case 3:
        return data.size() < 2 ? abort_code::command : describe(get16(data.data()), room, out);
      case 5:
        return data.size() < 4 ? abort_code::command
                               : describe_entry(get16(data.data()), data[2], data[3], room, out);
      default:
        return abort_code::unsupported;
    }
  }

  // As many messages as needed.
  static void send(std::uint8_t opcode, const Bytes& body, std::size_t room,
                   std::vector<Bytes>& out) {
    const std::size_t each = (room - 4) & ~std::size_t{1};
    std::size_t left = body.empty() ? 1 : (body.size() + each - 1) / each;
    for (std::size_t at = 0; left > 0; at += each) {
      --left;
      Bytes message = {static_cast<std::uint8_t>(opcode | (left ? 0x80 : 0)), 0, 0, 0};
      put16(&message[2], static_cast<std::uint16_t>(left));
      const auto from = body.begin() + static_cast<std::ptrdiff_t>(at);
      const std::size_t size = std::min(each, body.size() - at);
      message.insert(message.end(), from, from + static_cast<std::ptrdiff_t>(size));
      out.push_back(add_header(kSdoInformation, message));
    }
  }
  static void append16(Bytes& out, std::uint16_t value) {
    out.push_back(static_cast<std::uint8_t>(value));
    out.push_back(static_cast<std::uint8_t>(value >> 8));
  }
  static void append(Bytes& out, const std::string& text) {
    out.insert(out.end(), text.begin(), text.end());
  }

  // 1: all objects, 2 and 3: those that can be mapped to receive and to transmit, 4 and 5: none.
  Bytes list_objects(std::uint16_t kind) const {
    Bytes out;
    for (const std::uint16_t index : dictionary_.indices()) {
      bool there = kind == 1;
      for (const Entry& entry : dictionary_.object(index))
        there = there || (kind == 2 && maps(entry.pdo, Pdo::rx)) ||
                (kind == 3 && maps(entry.pdo, Pdo::tx));
      if (there) append16(out, index);
    }
    return out;
  }
  std::uint32_t list(std::uint16_t kind, std::size_t room, std::vector<Bytes>& out) const {
    if (kind > 5) return abort_code::unsupported;
    Bytes body;
    append16(body, kind);
    if (kind == 0) {
      for (std::uint16_t one = 1; one <= 5; ++one)
        append16(body, static_cast<std::uint16_t>(list_objects(one).size() / 2));
    } else {
      const Bytes indices = list_objects(kind);
      body.insert(body.end(), indices.begin(), indices.end());
    }
    send(2, body, room, out);
    return 0;
  }
  std::uint32_t describe(std::uint16_t index, std::size_t room, std::vector<Bytes>& out) const {
    const auto entries = dictionary_.object(index);
    if (entries.empty()) return abort_code::no_object;
    const Entry& first = entries[0];
    Bytes body;
    append16(body, index);
    append16(body,
             first.code == Code::record ? 0 : static_cast<std::uint16_t>(entries.back().type));
    body.push_back(first.last_sub);
    body.push_back(static_cast<std::uint8_t>(first.code));
    append(body, first.object);
    send(4, body, room, out);
    return 0;
  }
  std::uint32_t describe_entry(std::uint16_t index, std::uint8_t sub, std::uint8_t wanted,
                               std::size_t room, std::vector<Bytes>& out) const {
    const auto entries = dictionary_.object(index);
    if (entries.empty()) return abort_code::no_object;
    if (sub >= entries.size()) return abort_code::no_sub;
    const Entry& entry = entries[sub];
    const std::size_t size = (entry.bits + 7u) / 8;
    // Default, minimum and maximum, as requested; units are in the name.
    const auto info = static_cast<std::uint8_t>(wanted & (size ? 0x77 : 0x07));
    Bytes text;
    if (size == 0) dictionary_.read({index, sub}, text);
    Bytes body;
    append16(body, index);
    body.push_back(sub);
    body.push_back(info);
    append16(body, static_cast<std::uint16_t>(entry.type));
    append16(body, static_cast<std::uint16_t>(size ? entry.bits : 8 * text.size()));
    append16(body, find_access_rights(entry));
    const std::int64_t values[] = {entry.standard, entry.least, entry.most};
    for (int k = 0; k < 3; ++k)
      if (info & (0x10 << k))
        for (std::size_t byte = 0; byte < size; ++byte)
          body.push_back(static_cast<std::uint8_t>(values[k] >> (8 * byte)));
    append(body, entry.name);
    if (*entry.unit) append(body, std::string(" [") + entry.unit + "]");
    send(6, body, room, out);
    return 0;
  }
  // In PREOP, SAFEOP, OP: reading (bits 0 to 2), writing (3 to 5); mapping (6, 7).
  static std::uint16_t find_access_rights(const Entry& entry) {
    const bool mapping = (entry.index >= 0x1600 && entry.index < 0x1c00) || entry.index == 0x1c12 ||
                         entry.index == 0x1c13;
    unsigned out = entry.readable() ? 0x07 : 0;
    if (entry.writable()) out |= mapping ? 0x08 : 0x38;
    if (maps(entry.pdo, Pdo::rx)) out |= 0x40;
    if (maps(entry.pdo, Pdo::tx)) out |= 0x80;
    return static_cast<std::uint16_t>(out);
  }

  fieldbus::DriveDictionary dictionary_;
  fieldbus::SdoServer server_;
};

}  // namespace ethercat
