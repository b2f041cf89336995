// Block transfers of service data objects, as the server sees them (CiA 301, 7.2.4.3.9 to
// 7.2.4.3.17): up to 127 segments of 7 bytes, which are confirmed together. CAN only.
#pragma once

#include <algorithm>
#include <cstddef>
#include <optional>
#include <span>

#include "../abort_codes.hpp"
#include "../little_endian.hpp"

namespace fieldbus {

namespace sdo_block {

inline constexpr std::uint8_t kMost = 127;  // segments
inline constexpr std::uint8_t kLast = 0x80;
inline constexpr std::size_t kSegment = 7;  // bytes

// CRC-16, polynomial 0x1021, beginning with 0.
inline std::uint16_t compute_checksum(std::span<const std::uint8_t> data) {
  unsigned sum = 0;
  for (const std::uint8_t one : data) {
    sum ^= static_cast<unsigned>(one) << 8;
    for (int bit = 0; bit < 8; ++bit) sum = sum & 0x8000 ? sum << 1 ^ 0x1021 : sum << 1;
  }
  return static_cast<std::uint16_t>(sum);
}

}  // namespace sdo_block

// A value on its way to the client.
class BlockUpload {
 public:
  // `segments`: in a block, as the client wants it; `with_crc`: the client checks.
  BlockUpload(Bytes value, std::uint8_t segments, bool with_crc)
      : value_(std::move(value)), segments_(segments), with_crc_(with_crc) {}

  // Answer a request: an abort code, or replies in `out`.
  std::uint32_t answer(std::span<const std::uint8_t> request, std::vector<Bytes>& out) {
    const std::uint8_t command = request[0];
    if (command == 0xA3 && !started_) {
      started_ = true;
      send_block(out);
    } else if (command == 0xA2 && started_ && sent_) {
      if (request[1] > sent_) return abort_code::sequence;
      if (!request[2] || request[2] > sdo_block::kMost) return abort_code::block_size;
      segments_ = request[2];
      at_ = std::min(at_ + sdo_block::kSegment * request[1], value_.size());
      if (at_ < value_.size())
        send_block(out);
      else
        send_end(out);
    } else if (command == 0xA1 && started_ && !sent_) {
      over_ = true;
    } else {
      return abort_code::command;
    }
    return abort_code::none;
  }
  bool over() const { return over_; }

 private:
  void send_block(std::vector<Bytes>& out) {
    bool last = false;
    for (sent_ = 0; sent_ < segments_ && !last;) {
      const std::size_t from = std::min(at_ + sdo_block::kSegment * sent_, value_.size());
      const std::size_t size = std::min(sdo_block::kSegment, value_.size() - from);
      last = from + size == value_.size();
      Bytes frame = {static_cast<std::uint8_t>(++sent_ | (last ? sdo_block::kLast : 0))};
      const auto first = value_.begin() + static_cast<std::ptrdiff_t>(from);
      frame.insert(frame.end(), first, first + static_cast<std::ptrdiff_t>(size));
      frame.resize(8, 0);
      out.push_back(std::move(frame));
    }
  }
  void send_end(std::vector<Bytes>& out) {
    sent_ = 0;
    const std::size_t over = value_.size() % sdo_block::kSegment;
    const std::size_t unused = over || value_.empty() ? sdo_block::kSegment - over : 0;
    Bytes frame(8, 0);
    frame[0] = static_cast<std::uint8_t>(0xC1 | unused << 2);
    if (with_crc_) put16(&frame[1], sdo_block::compute_checksum(value_));
    out.push_back(std::move(frame));
  }

  const Bytes value_;
  std::uint8_t segments_;
  const bool with_crc_;
  std::size_t at_ = 0;  // bytes that the client has confirmed
  unsigned sent_ = 0;   // segments of the block that is on its way
  bool started_ = false, over_ = false;
};

// A value on its way from the client.
class BlockDownload {
 public:
  // `announced`: its bytes, where the client knows them; `largest`: what is taken at most.
  BlockDownload(std::optional<std::size_t> announced, std::size_t largest, bool with_crc)
      : announced_(announced), largest_(largest), with_crc_(with_crc) {}

  // Answer a request that carries a segment: an abort code, or replies in `out`.
  std::uint32_t take(std::span<const std::uint8_t> request, std::vector<Bytes>& out) {
    const std::uint8_t number = request[0] & 0x7F;
    const bool last = request[0] & sdo_block::kLast;
    if (number == 0 || number <= newest_) return abort_code::sequence;
    newest_ = number;
    if (number == number_ + 1) {  // one that was lost is sent again, and all after it
      number_ = number;
      value_.insert(value_.end(), request.begin() + 1, request.end());
      if (value_.size() > largest_ + sdo_block::kSegment) return abort_code::memory;
      complete_ = last;
    }
    if (!last && number != sdo_block::kMost) return abort_code::none;
    out.push_back({0xA2, number_, sdo_block::kMost, 0, 0, 0, 0, 0});
    number_ = newest_ = 0;
    return abort_code::none;
  }
  // Whether all segments are there, and the next request is the end.
  bool complete() const { return complete_; }
  // Check the end, and leave what was sent in `value`.
  std::uint32_t finish(std::span<const std::uint8_t> request, Bytes& value) {
    if ((request[0] & 0xE3) != 0xC1) return abort_code::command;
    value_.erase(value_.end() - (request[0] >> 2 & 7), value_.end());
    if (with_crc_ && sdo_block::compute_checksum(value_) != get16(&request[1]))
      return abort_code::checksum;
    if (announced_ && *announced_ != value_.size()) return abort_code::wrong_length;
    value = std::move(value_);
    return abort_code::none;
  }

 private:
  const std::optional<std::size_t> announced_;
  const std::size_t largest_;
  const bool with_crc_;
  Bytes value_;
  std::uint8_t number_ = 0;  // of the segment that came last in its turn
  std::uint8_t newest_ = 0;  // and of the one that came last at all
  bool complete_ = false;
};

}  // namespace fieldbus
