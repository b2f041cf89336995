// The server of service data objects: a client reads and writes a drive's object dictionary
// (CiA 301, 7.2.4; ETG.1000.6, 5.6.2). One server for both buses. They differ in what carries a
// request. CAN has frames of 8 bytes, and block transfers. EtherCAT has messages of a mailbox: the
// first message has room for data, and a request may reach all of an object at once.
#pragma once

#include <variant>

#include "../drive_dictionary.hpp"
#include "sdo_block.hpp"

namespace fieldbus {

class SdoServer {
 public:
  enum class Carrier : std::uint8_t { can, mailbox };

  SdoServer(Drive& drive, Carrier carrier) : dictionary_(drive), carrier_(carrier) {}

  // Forget a transfer that is under way.
  void begin() {
    transfer_.emplace<std::monostate>();
    at_ = {};
  }

  // Answer a request of 8 bytes at least. `room`: bytes of a reply at most, 8 at least.
  void answer(std::span<const std::uint8_t> request, std::size_t room, std::vector<Bytes>& out) {
    if (std::holds_alternative<std::monostate>(transfer_)) at_ = {};  // a segment names none
    const std::uint32_t abort = serve(request, room, out);
    if (abort == abort_code::none) return;
    Bytes reply = make_header(kAbort, at_);
    put32(&reply[4], abort);
    begin();
    out.push_back(std::move(reply));
  }
  static bool is_abort(const Bytes& reply) { return reply[0] == kAbort; }

 private:
  using Request = std::span<const std::uint8_t>;
  static constexpr std::uint8_t kAbort = 0x80, kComplete = 0x10, kToggle = 0x10;

  struct Upload {
    Bytes data;
    std::size_t sent = 0;
    std::uint8_t toggle = 0;
  };
  struct Download {
    std::optional<std::size_t> announced;
    Bytes data = {};
    std::uint8_t toggle = 0;
  };

  bool in_mailbox() const { return carrier_ == Carrier::mailbox; }
  std::size_t largest() const { return in_mailbox() ? 0x10000 : 256; }  // bytes of a download

  static Bytes make_header(std::uint8_t command, const SdoObject& at) {
    Bytes out(8, 0);
    out[0] = command;
    put16(&out[1], at.index);
    out[3] = at.sub;
    return out;
  }
  std::uint8_t echo() const { return at_.complete ? kComplete : 0; }

  // Begin a transfer of the object that a request names.
  void begin_with(Request request) {
    begin();
    at_ = {get16(&request[1]), request[3], in_mailbox() && (request[0] & kComplete)};
  }

  std::uint32_t serve(Request request, std::size_t room, std::vector<Bytes>& out) {
    const std::uint8_t command = request[0];
    if (command != kAbort) {
      if (std::holds_alternative<BlockUpload>(transfer_)) return go_on_upload(request, out);
      if (std::holds_alternative<BlockDownload>(transfer_)) return go_on_download(request, out);
    }
    switch (command >> 5) {
      case 0:
        return take_segment(request, out);
      case 1:
        return begin_download(request, out);
      case 2:
        return begin_upload(request, room, out);
      case 3:
        return give_segment(command, room, out);
      case 4:
        begin();  // the client has given up
        return abort_code::none;
      case 5:
        if (!in_mailbox() && !(command & 3)) return begin_block_upload(request, out);
        break;
      case 6:
        if (!in_mailbox() && !(command & 1)) return begin_block_download(request, out);
        break;
      default:
        break;
    }
    begin_with(request);
    return abort_code::command;
  }

  // ------------------------------------------------------------------------------------ upload

  std::uint32_t begin_upload(Request request, std::size_t room, std::vector<Bytes>& out) {
    begin_with(request);
    Bytes data;
    const std::uint32_t abort = dictionary_.read(at_, data);
    if (abort) return abort;
    const std::size_t size = data.size();
    const bool expedited = size >= 1 && size <= 4;
    const auto unused = static_cast<std::uint8_t>(expedited ? (4 - size) << 2 : 0);
    Bytes reply =
        make_header(static_cast<std::uint8_t>((expedited ? 0x43 | unused : 0x41) | echo()), at_);
    if (expedited) {
      std::copy(data.begin(), data.end(), reply.begin() + 4);
    } else {
      const std::size_t now = std::min(size, room - reply.size());
      put32(&reply[4], static_cast<std::uint32_t>(size));
      reply.insert(reply.end(), data.begin(), data.begin() + static_cast<std::ptrdiff_t>(now));
      if (now < size || !in_mailbox()) transfer_ = Upload{std::move(data), now};
    }
    out.push_back(std::move(reply));
    return abort_code::none;
  }
  std::uint32_t give_segment(std::uint8_t command, std::size_t room, std::vector<Bytes>& out) {
    Upload* const upload = std::get_if<Upload>(&transfer_);
    if (!upload) return abort_code::command;
    if ((command & kToggle) != upload->toggle) return abort_code::toggle;
    const std::size_t now = std::min(upload->data.size() - upload->sent, room - 1);
    const bool last = upload->sent + now == upload->data.size();
    const std::size_t unused = now < 7 ? 7 - now : 0;
    Bytes reply = {static_cast<std::uint8_t>(upload->toggle | unused << 1 | (last ? 1 : 0))};
    const auto from = upload->data.begin() + static_cast<std::ptrdiff_t>(upload->sent);
    reply.insert(reply.end(), from, from + static_cast<std::ptrdiff_t>(now));
    reply.resize(reply.size() + unused, 0);
    out.push_back(std::move(reply));
    upload->sent += now;
    upload->toggle ^= kToggle;
    if (last) begin();
    return abort_code::none;
  }

  // ---------------------------------------------------------------------------------- download

  std::uint32_t begin_download(Request request, std::vector<Bytes>& out) {
    begin_with(request);
    const std::uint8_t command = request[0];
    const bool expedited = command & 2, sized = command & 1;
    std::uint32_t abort = abort_code::none;
    if (expedited) {
      const std::size_t size = sized ? 4u - (command >> 2 & 3u) : dictionary_.length(at_);
      abort = dictionary_.write(at_, request.subspan(4, size));
    } else {
      abort = begin_full_download(request, sized);
    }
    if (abort) return abort;
    out.push_back(make_header(static_cast<std::uint8_t>(0x60 | echo()), at_));
    return abort_code::none;
  }
  // The first message holds all of it, or segments follow.
  std::uint32_t begin_full_download(Request request, bool sized) {
    const Request data = request.subspan(8);
    if (!sized && in_mailbox()) return abort_code::command;
    std::optional<std::size_t> size;
    if (sized) size = get32(&request[4]);
    if (size && *size > largest()) return abort_code::memory;
    if (size && *size < data.size()) return abort_code::wrong_length;
    if (in_mailbox() && size && *size == data.size()) return dictionary_.write(at_, data);
    if (dictionary_.object(at_.index).empty()) return abort_code::no_object;
    transfer_ = Download{size, Bytes(data.begin(), data.end())};
    return abort_code::none;
  }
  std::uint32_t take_segment(Request request, std::vector<Bytes>& out) {
    Download* const download = std::get_if<Download>(&transfer_);
    const std::uint8_t command = request[0];
    if (!download) return abort_code::command;
    if ((command & kToggle) != download->toggle) return abort_code::toggle;
    const std::size_t unused = request.size() == 8 ? command >> 1 & 7u : 0;
    const Request data = request.subspan(1, request.size() - 1 - unused);
    Bytes& taken = download->data;
    taken.insert(taken.end(), data.begin(), data.end());
    if (taken.size() > largest()) return abort_code::memory;
    if (download->announced && taken.size() > *download->announced) return abort_code::wrong_length;
    Bytes reply(8, 0);
    reply[0] = 0x20 | download->toggle;
    download->toggle ^= kToggle;
    if (command & 1) {
      if (download->announced && taken.size() != *download->announced)
        return abort_code::wrong_length;
      const std::uint32_t abort = dictionary_.write(at_, taken);
      if (abort) return abort;
      begin();
    }
    out.push_back(std::move(reply));
    return abort_code::none;
  }

  // ------------------------------------------------------------------------------------ blocks

  std::uint32_t begin_block_upload(Request request, std::vector<Bytes>& out) {
    begin_with(request);
    Bytes value;
    const std::uint32_t abort = dictionary_.read(at_, value);
    if (abort) return abort;
    const std::uint8_t segments = request[4];
    if (!segments || segments > sdo_block::kMost) return abort_code::block_size;
    Bytes reply = make_header(0xC6, at_);
    put32(&reply[4], static_cast<std::uint32_t>(value.size()));
    transfer_.emplace<BlockUpload>(std::move(value), segments, (request[0] & 4) != 0);
    out.push_back(std::move(reply));
    return abort_code::none;
  }
  std::uint32_t go_on_upload(Request request, std::vector<Bytes>& out) {
    BlockUpload& upload = std::get<BlockUpload>(transfer_);
    const std::uint32_t abort = upload.answer(request, out);
    if (upload.over()) begin();
    return abort;
  }
  std::uint32_t begin_block_download(Request request, std::vector<Bytes>& out) {
    begin_with(request);
    std::optional<std::size_t> announced;
    if (request[0] & 2) announced = get32(&request[4]);
    if (announced && *announced > largest()) return abort_code::memory;
    transfer_.emplace<BlockDownload>(announced, largest(), (request[0] & 4) != 0);
    Bytes reply = make_header(0xA4, at_);
    reply[4] = sdo_block::kMost;
    out.push_back(std::move(reply));
    return abort_code::none;
  }
  std::uint32_t go_on_download(Request request, std::vector<Bytes>& out) {
    BlockDownload& download = std::get<BlockDownload>(transfer_);
    if (!download.complete()) return download.take(request, out);
    Bytes value;
    std::uint32_t abort = download.finish(request, value);
    if (!abort) abort = dictionary_.write(at_, value);
    if (abort) return abort;
    begin();
    out.push_back({0xA1, 0, 0, 0, 0, 0, 0, 0});
    return abort_code::none;
  }

  DriveDictionary dictionary_;
  const Carrier carrier_;
  SdoObject at_;  // what the transfer is about
  std::variant<std::monostate, Upload, Download, BlockUpload, BlockDownload> transfer_;
};

}  // namespace fieldbus
