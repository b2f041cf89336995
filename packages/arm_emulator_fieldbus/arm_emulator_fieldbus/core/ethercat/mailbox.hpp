// The mailbox of a slave: messages from the master in sync manager 0, to the master in 1
// (ETG.1000.4, section 5.5).
#pragma once

#include <deque>

#include "coe.hpp"
#include "sync_managers.hpp"

namespace ethercat {

class Mailbox {
 public:
  static constexpr int kOut = 0, kIn = 1;  // sync managers, as the master sees them

  Mailbox(SyncManagers& managers, Drive& drive) : managers_(managers), coe_(drive) {}

  // Empty, as after INIT.
  void begin() {
    waiting_.clear();
    newest_.clear();
    counted_ = answered_ = 0;
    coe_.begin();
    managers_.set_full(kOut, false);
    managers_.set_full(kIn, false);
    repeated_ = managers_.is_repeat_requested(kIn);
    managers_.acknowledge_repeat(kIn);
  }

  // The master has written a whole message, which waits until there is room for replies.
  void written() {
    managers_.set_full(kOut, true);
    serve();
  }
  // The master has read the message: the next one.
  void read() {
    managers_.set_full(kIn, false);
    fill();
    serve();
  }
  // The master has lost a reply, and requests it again.
  void handle_write() {
    if (!managers_.is_enabled(kIn)) return;
    if (managers_.is_repeat_requested(kIn) == repeated_) return;
    repeated_ = managers_.is_repeat_requested(kIn);
    if (!newest_.empty() && !managers_.is_full(kIn)) put(newest_);
    managers_.acknowledge_repeat(kIn);
  }

  void send_emergency(std::uint16_t code, std::uint8_t error_register) {
    if (managers_.is_enabled(kIn) && waiting_.size() < kMost)
      send(kCoe, Coe::make_emergency(code, error_register));
  }

 private:
  static constexpr std::uint8_t kError = 0, kCoe = 3;
  static constexpr std::size_t kHeader = 6, kMost = 16;

  void serve() {
    if (!managers_.is_enabled(kOut) || !managers_.is_full(kOut) || waiting_.size() >= kMost) return;
    const Bytes message(managers_.area(kOut), managers_.area(kOut) + managers_.length(kOut));
    managers_.set_full(kOut, false);
    const std::size_t size = get16(message.data());
    const int type = message[5] & 0x0f, counter = (message[5] >> 4) & 7;
    if (counter != 0 && counter == counted_) return;  // sent twice: the answer follows
    counted_ = counter;
    MailboxError error = MailboxError::none;
    std::vector<Bytes> replies;
    if (size > message.size() - kHeader)
      error = MailboxError::size;
    else if (type == kError)
      return;
    else if (type != kCoe)
      error = MailboxError::protocol;
    else
      error =
          coe_.serve({message.data() + kHeader, size}, managers_.length(kIn) - kHeader, replies);
    if (error != MailboxError::none) {
      Bytes body = {1, 0, 0, 0};
      put16(&body[2], static_cast<std::uint16_t>(error));
      send(kError, body);
    }
    for (const Bytes& reply : replies) send(kCoe, reply);
  }

  void send(std::uint8_t type, const Bytes& body) {
    answered_ = answered_ % 7 + 1;
    Bytes message(kHeader, 0);
    put16(message.data(), static_cast<std::uint16_t>(body.size()));
    message[5] = static_cast<std::uint8_t>(type | answered_ << 4);
    message.insert(message.end(), body.begin(), body.end());
    waiting_.push_back(std::move(message));
    fill();
  }
  void fill() {
    if (waiting_.empty() || !managers_.is_enabled(kIn) || managers_.is_full(kIn)) return;
    newest_ = std::move(waiting_.front());
    waiting_.pop_front();
    put(newest_);
  }
  void put(const Bytes& message) {
    const std::size_t size = std::min(message.size(), managers_.length(kIn));
    std::fill_n(managers_.area(kIn), managers_.length(kIn), std::uint8_t{0});
    std::copy_n(message.begin(), size, managers_.area(kIn));
    managers_.set_full(kIn, true);
  }

  SyncManagers& managers_;
  Coe coe_;
  std::deque<Bytes> waiting_;
  Bytes newest_;
  int counted_ = 0;   // counter of the newest message from the master
  int answered_ = 0;  // and of ours
  bool repeated_ = false;
};

}  // namespace ethercat
