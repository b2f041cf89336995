// CANopen over EtherCAT: the services by which a master reads and writes a drive's object
// dictionary (ETG.1000.6, section 5.6): SDO, expedited, whole and in segments, one entry or all of
// an object at once (complete access), SDO information, and emergencies.
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "ethercat_frame.hpp"
#include "ethercat_objects.hpp"

namespace ethercat {

using Bytes = std::vector<std::uint8_t>;

// Details of a mailbox error, ETG.1000.4, table 30.
enum class MailboxError : std::uint16_t {
  NONE = 0,
  PROTOCOL = 2,
  SERVICE = 4,
  TOO_SHORT = 6,
  SIZE = 8
};

class Coe {
 public:
  Coe(const Objects& objects, const Door& door) : objects(objects), door(door) {}

  // Forgets transfers that are under way.
  void begin() {
    upload.reset();
    download.reset();
  }

  // Serve a request: CoE header and what follows it. `room`: how long a reply may be. Replies are
  // appended to `out`.
  MailboxError serve(std::span<const std::uint8_t> request, std::size_t room,
                     std::vector<Bytes>& out) {
    if (request.size() < 2) return MailboxError::TOO_SHORT;
    const int service = request[1] >> 4;
    if (service == kSdoRequest) {
      if (request.size() < 10) return MailboxError::TOO_SHORT;
      const std::uint32_t abort = sdo(request.subspan(2), room - 2, out);
      if (abort != 0) out.push_back(aborted(request.subspan(2), abort));
      return MailboxError::NONE;
    }
    if (service == kSdoInformation) {
      if (request.size() < 6) return MailboxError::TOO_SHORT;
      const std::uint32_t abort = information(request.subspan(2), room - 2, out);
      if (abort != 0) {
        Bytes error = {kInformationError, 0, 0, 0, 0, 0, 0, 0};
        put32(&error[4], abort);
        out.push_back(with_header(kSdoInformation, error));
      }
      return MailboxError::NONE;
    }
    return MailboxError::SERVICE;
  }

  // The message that tells a master of an error (0x603F, 0x1001).
  static Bytes emergency(std::uint16_t code, std::uint8_t error_register) {
    Bytes body(8, 0);
    put16(&body[0], code);
    body[2] = error_register;
    return with_header(kEmergency, body);
  }

 private:
  static constexpr std::uint8_t kEmergency = 1, kSdoRequest = 2, kSdoResponse = 3,
                                kSdoInformation = 8, kInformationError = 7;
  static constexpr std::size_t kLargest = 0x10000;  // bytes of a download

  struct Upload {
    Bytes data;
    std::size_t sent;
    bool toggle;
  };
  struct Download {
    std::uint16_t index;
    std::uint8_t sub;
    bool complete;
    std::size_t size;
    Bytes data;
    bool toggle;
  };

  static Bytes with_header(std::uint8_t service, const Bytes& body) {
    Bytes out = {0, static_cast<std::uint8_t>(service << 4)};
    out.insert(out.end(), body.begin(), body.end());
    return out;
  }
  static Bytes head(std::uint8_t command, std::uint16_t index, std::uint8_t sub) {
    Bytes out(8, 0);
    out[0] = command;
    put16(&out[1], index);
    out[3] = sub;
    return out;
  }
  Bytes aborted(std::span<const std::uint8_t> sdo, std::uint32_t code) {
    begin();
    Bytes out = head(0x80, get16(&sdo[1]), sdo[3]);
    put32(&out[4], code);
    return with_header(kSdoRequest, out);
  }

  // ------------------------------------------------------------------------------------- SDO

  // An abort code, or a reply in `out`. `sdo` has 8 bytes at least.
  std::uint32_t sdo(std::span<const std::uint8_t> sdo, std::size_t room, std::vector<Bytes>& out) {
    const std::uint8_t command = sdo[0];
    switch (command >> 5) {
      case 0:
        return next_download(sdo, out);
      case 1:
        return begin_download(sdo, out);
      case 2:
        return begin_upload(sdo, room, out);
      case 3:
        return next_upload(sdo, room, out);
      case 4:
        begin();
        return 0;  // the master has given up
      default:
        return abort_code::command;
    }
  }

  std::uint32_t begin_upload(std::span<const std::uint8_t> sdo, std::size_t room,
                             std::vector<Bytes>& out) {
    begin();
    const bool complete = sdo[0] & 0x10;
    const std::uint16_t index = get16(&sdo[1]);
    Bytes data;
    const std::uint32_t abort =
        complete ? read_all(index, sdo[3], data) : read(index, sdo[3], data);
    if (abort != 0) return abort;
    const std::uint8_t echo = complete ? 0x10 : 0;
    if (!data.empty() && data.size() <= 4) {
      const auto unused = static_cast<std::uint8_t>((4 - data.size()) << 2);
      Bytes reply = head(static_cast<std::uint8_t>(0x43 | unused | echo), index, sdo[3]);
      std::copy(data.begin(), data.end(), reply.begin() + 4);
      out.push_back(with_header(kSdoResponse, reply));
      return 0;
    }
    Bytes reply = head(static_cast<std::uint8_t>(0x41 | echo), index, sdo[3]);
    put32(&reply[4], static_cast<std::uint32_t>(data.size()));
    const std::size_t now = std::min(data.size(), room - reply.size());
    reply.insert(reply.end(), data.begin(), data.begin() + static_cast<std::ptrdiff_t>(now));
    out.push_back(with_header(kSdoResponse, reply));
    if (now < data.size()) upload = Upload{std::move(data), now, false};
    return 0;
  }

  std::uint32_t next_upload(std::span<const std::uint8_t> sdo, std::size_t room,
                            std::vector<Bytes>& out) {
    if (!upload) return abort_code::command;
    if (((sdo[0] >> 4) & 1) != (upload->toggle ? 1 : 0)) return abort_code::toggle;
    const std::size_t now = std::min(upload->data.size() - upload->sent, room - 1);
    const bool last = upload->sent + now == upload->data.size();
    const std::size_t unused = now < 7 ? 7 - now : 0;
    Bytes reply = {static_cast<std::uint8_t>((sdo[0] & 0x10) | unused << 1 | (last ? 1 : 0))};
    const auto from = upload->data.begin() + static_cast<std::ptrdiff_t>(upload->sent);
    reply.insert(reply.end(), from, from + static_cast<std::ptrdiff_t>(now));
    reply.resize(reply.size() + unused, 0);
    out.push_back(with_header(kSdoResponse, reply));
    upload->sent += now;
    upload->toggle = !upload->toggle;
    if (last) upload.reset();
    return 0;
  }

  std::uint32_t begin_download(std::span<const std::uint8_t> sdo, std::vector<Bytes>& out) {
    begin();
    const std::uint8_t command = sdo[0];
    const bool complete = command & 0x10, sized = command & 1;
    const std::uint16_t index = get16(&sdo[1]);
    const std::uint8_t sub = sdo[3];
    std::uint32_t abort = 0;
    if (command & 2) {
      std::size_t size = sized ? 4u - ((command >> 2) & 3u) : 4;
      const drives_entry* const entry = objects.entry(index, sub);
      if (!sized && entry && entry->bits > 0 && entry->bits <= 32) size = (entry->bits + 7u) / 8;
      abort = store(index, sub, complete, sdo.subspan(4, size));
    } else {
      if (!sized) return abort_code::command;
      const std::size_t size = get32(&sdo[4]), here = sdo.size() - 8;
      if (size > kLargest) return abort_code::memory;
      if (here > size) return abort_code::wrong_length;
      const auto data = sdo.subspan(8);
      if (here < size) {
        if (objects.object(index).empty()) return abort_code::no_object;
        download = Download{index, sub, complete, size, Bytes(data.begin(), data.end()), false};
      } else {
        abort = store(index, sub, complete, data);
      }
    }
    if (abort != 0) return abort;
    out.push_back(with_header(
        kSdoResponse, head(static_cast<std::uint8_t>(0x60 | (command & 0x10)), index, sub)));
    return 0;
  }

  std::uint32_t next_download(std::span<const std::uint8_t> sdo, std::vector<Bytes>& out) {
    if (!download) return abort_code::command;
    const std::uint8_t command = sdo[0];
    if (((command >> 4) & 1) != (download->toggle ? 1 : 0)) return abort_code::toggle;
    const std::size_t unused = sdo.size() == 8 ? (command >> 1) & 7u : 0;
    const auto data = sdo.subspan(1, sdo.size() - 1 - unused);
    if (download->data.size() + data.size() > download->size) return abort_code::wrong_length;
    download->data.insert(download->data.end(), data.begin(), data.end());
    download->toggle = !download->toggle;
    if (command & 1) {
      const Download whole = std::move(*download);
      download.reset();
      if (whole.data.size() != whole.size) return abort_code::wrong_length;
      const std::uint32_t abort = store(whole.index, whole.sub, whole.complete, whole.data);
      if (abort != 0) {
        // The abort names the object, not the segment.
        Bytes about = head(0x80, whole.index, whole.sub);
        out.push_back(aborted(about, abort));
        return 0;
      }
    }
    Bytes reply(8, 0);
    reply[0] = static_cast<std::uint8_t>(0x20 | (command & 0x10));
    out.push_back(with_header(kSdoResponse, reply));
    return 0;
  }

  std::uint32_t store(std::uint16_t index, std::uint8_t sub, bool complete,
                      std::span<const std::uint8_t> data) {
    return complete ? write_all(index, sub, data) : door.write(index, sub, data);
  }

  std::uint32_t read(std::uint16_t index, std::uint8_t sub, Bytes& out) const {
    std::uint8_t value[512];
    std::uint32_t size = 0;
    const std::uint32_t abort = door.read(index, sub, value, size);
    if (abort == 0) out.insert(out.end(), value, value + size);
    return abort;
  }

  // ------------------------------------------------------------------------- complete access

  // How many subs an object has now: as its sub 0 says, which masters set of mappings and
  // assignments.
  std::size_t subs(std::span<const drives_entry> object) const {
    return std::min<std::size_t>(door.number(object[0].index, 0), object.size() - 1);
  }

  std::uint32_t read_all(std::uint16_t index, std::uint8_t from, Bytes& out) const {
    const auto object = objects.object(index);
    if (object.empty()) return abort_code::no_object;
    if (from > 1) return abort_code::unsupported;
    if (object.size() == 1) return from == 0 ? read(index, 0, out) : abort_code::no_sub;
    const std::size_t count = subs(object);
    if (from == 0) {
      out.push_back(static_cast<std::uint8_t>(count));
      out.push_back(0);  // sub 0 takes 16 bits
    }
    for (std::size_t sub = 1; sub <= count; ++sub) {
      const std::uint32_t abort = read(index, static_cast<std::uint8_t>(sub), out);
      if (abort != 0) return abort;
    }
    return 0;
  }

  // All or nothing: what was written is taken back when a later entry is refused.
  std::uint32_t write_all(std::uint16_t index, std::uint8_t from,
                          std::span<const std::uint8_t> data) {
    const auto object = objects.object(index);
    if (object.empty()) return abort_code::no_object;
    if (from > 1) return abort_code::unsupported;
    if (object.size() == 1) return from == 0 ? door.write(index, 0, data) : abort_code::no_sub;
    const bool counted = writable(object[0]);  // mapping, assignment: sub 0 is 0 meanwhile
    std::vector<Bytes> before(object.size());
    for (std::size_t sub = 0; sub < object.size(); ++sub)
      read(index, static_cast<std::uint8_t>(sub), before[sub]);
    const std::uint32_t abort = write_subs(object, from, data, counted);
    if (abort == 0) return 0;
    const std::uint8_t none[1] = {0};
    if (counted) door.write(index, 0, none);
    for (std::size_t sub = 1; sub < object.size(); ++sub)
      if (writable(object[sub])) door.write(index, static_cast<std::uint8_t>(sub), before[sub]);
    if (counted) door.write(index, 0, before[0]);
    return abort;
  }

  std::uint32_t write_subs(std::span<const drives_entry> object, std::uint8_t from,
                           std::span<const std::uint8_t> data, bool counted) {
    const std::uint16_t index = object[0].index;
    std::uint8_t count = static_cast<std::uint8_t>(door.number(index, 0));
    if (from == 0) {
      if (data.empty()) return abort_code::too_short;
      if (counted) count = data[0];
      data = data.subspan(std::min<std::size_t>(2, data.size()));
    }
    const std::uint8_t none[1] = {0}, total[1] = {count};
    std::uint32_t abort = counted ? door.write(index, 0, none) : 0;
    for (std::size_t sub = 1; abort == 0 && sub < object.size() && !data.empty(); ++sub) {
      const std::size_t size = (object[sub].bits + 7u) / 8;
      if (size == 0) return abort_code::unsupported;  // a text has no place of its own
      if (data.size() < size) return abort_code::too_short;
      if (writable(object[sub]))
        abort = door.write(index, static_cast<std::uint8_t>(sub), data.first(size));
      data = data.subspan(size);
    }
    if (abort == 0 && !data.empty()) return abort_code::wrong_length;
    return abort == 0 && counted ? door.write(index, 0, total) : abort;
  }

  // ------------------------------------------------------------------------- SDO information

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

  // As many messages as it takes.
  static void tell(std::uint8_t opcode, const Bytes& body, std::size_t room,
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
      out.push_back(with_header(kSdoInformation, message));
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
  Bytes objects_of(std::uint16_t kind) const {
    Bytes out;
    for (const std::uint16_t index : objects.all()) {
      bool there = kind == 1;
      for (const drives_entry& entry : objects.object(index))
        there = there || (kind == 2 && entry.pdo & 1) || (kind == 3 && entry.pdo & 2);
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
        append16(body, static_cast<std::uint16_t>(objects_of(one).size() / 2));
    } else {
      const Bytes indices = objects_of(kind);
      body.insert(body.end(), indices.begin(), indices.end());
    }
    tell(2, body, room, out);
    return 0;
  }
  std::uint32_t describe(std::uint16_t index, std::size_t room, std::vector<Bytes>& out) const {
    const auto object = objects.object(index);
    if (object.empty()) return abort_code::no_object;
    const drives_entry& first = object[0];
    Bytes body;
    append16(body, index);
    append16(body, first.code == 7 ? first.type : first.code == 8 ? object.back().type : 0);
    body.push_back(first.last_sub);
    body.push_back(first.code);
    append(body, first.object);
    tell(4, body, room, out);
    return 0;
  }
  std::uint32_t describe_entry(std::uint16_t index, std::uint8_t sub, std::uint8_t wanted,
                               std::size_t room, std::vector<Bytes>& out) const {
    const auto object = objects.object(index);
    if (object.empty()) return abort_code::no_object;
    if (sub >= object.size()) return abort_code::no_sub;
    const drives_entry& entry = object[sub];
    const std::size_t size = (entry.bits + 7u) / 8;
    // Default, least and most, where asked for; units stand in the name.
    const auto told = static_cast<std::uint8_t>(wanted & (size ? 0x77 : 0x07));
    std::uint32_t length = 0;
    if (size == 0) {
      std::uint8_t value[512];
      door.read(index, sub, value, length);
    }
    Bytes body;
    append16(body, index);
    body.push_back(sub);
    body.push_back(told);
    append16(body, entry.type);
    append16(body, static_cast<std::uint16_t>(size ? entry.bits : 8 * length));
    append16(body, rights(entry));
    const std::int64_t values[] = {entry.standard, entry.least, entry.most};
    for (int k = 0; k < 3; ++k)
      if (told & (0x10 << k))
        for (std::size_t byte = 0; byte < size; ++byte)
          body.push_back(static_cast<std::uint8_t>(values[k] >> (8 * byte)));
    append(body, entry.name);
    if (*entry.unit) append(body, std::string(" [") + entry.unit + "]");
    tell(6, body, room, out);
    return 0;
  }
  // In PREOP, SAFEOP, OP: reading (bits 0 to 2), writing (3 to 5); mapping (6, 7).
  static std::uint16_t rights(const drives_entry& entry) {
    const bool mapping = (entry.index >= 0x1600 && entry.index < 0x1c00) || entry.index == 0x1c12 ||
                         entry.index == 0x1c13;
    unsigned out = entry.access == 2 ? 0 : 0x07;
    if (writable(entry)) out |= mapping ? 0x08 : 0x38;
    if (entry.pdo & 1) out |= 0x40;
    if (entry.pdo & 2) out |= 0x80;
    return static_cast<std::uint16_t>(out);
  }

  const Objects& objects;
  const Door& door;
  std::optional<Upload> upload;
  std::optional<Download> download;
};

}  // namespace ethercat
