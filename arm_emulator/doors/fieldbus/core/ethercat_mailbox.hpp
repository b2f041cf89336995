// The mailbox of a slave: messages from the master in sync manager 0, to the master in 1
// (ETG.1000.4, section 5.5).
#pragma once

#include <deque>

#include "ethercat_coe.hpp"
#include "ethercat_sync_managers.hpp"

namespace ethercat {

class Mailbox {
 public:
  static constexpr int kOut = 0, kIn = 1;  // sync managers, as the master sees them

  Mailbox(SyncManagers& managers, const Objects& objects, const Door& door)
      : managers(managers), coe(objects, door) {}

  // Empty, as after INIT.
  void begin() {
    waiting.clear();
    newest.clear();
    counted = answered = 0;
    coe.begin();
    managers.set_full(kOut, false);
    managers.set_full(kIn, false);
    repeated = managers.repeat_requested(kIn);
    managers.acknowledge_repeat(kIn);
  }

  // The master has written a whole message, which stays where it is until there is room for
  // replies.
  void written() {
    managers.set_full(kOut, true);
    serve();
  }
  // The master has read the message: the next one.
  void read() {
    managers.set_full(kIn, false);
    fill();
    serve();
  }
  // The master has not got what it has read, and asks for it once more.
  void after_write() {
    if (!managers.enabled(kIn)) return;
    if (managers.repeat_requested(kIn) == repeated) return;
    repeated = managers.repeat_requested(kIn);
    if (!newest.empty() && !managers.full(kIn)) put(newest);
    managers.acknowledge_repeat(kIn);
  }

  void emergency(std::uint16_t code, std::uint8_t error_register) {
    if (managers.enabled(kIn) && waiting.size() < kMost)
      send(kCoe, Coe::emergency(code, error_register));
  }

 private:
  static constexpr std::uint8_t kError = 0, kCoe = 3;
  static constexpr std::size_t kHeader = 6, kMost = 16;

  void serve() {
    if (!managers.enabled(kOut) || !managers.full(kOut) || waiting.size() >= kMost) return;
    const Bytes message(managers.area(kOut), managers.area(kOut) + managers.length(kOut));
    managers.set_full(kOut, false);
    const std::size_t size = get16(message.data());
    const int type = message[5] & 0x0f, counter = (message[5] >> 4) & 7;
    if (counter != 0 && counter == counted) return;  // sent twice: the answer is on its way
    counted = counter;
    MailboxError error = MailboxError::NONE;
    std::vector<Bytes> replies;
    if (size > message.size() - kHeader)
      error = MailboxError::SIZE;
    else if (type == kError)
      return;
    else if (type != kCoe)
      error = MailboxError::PROTOCOL;
    else
      error = coe.serve({message.data() + kHeader, size}, managers.length(kIn) - kHeader, replies);
    if (error != MailboxError::NONE) {
      Bytes body = {1, 0, 0, 0};
      put16(&body[2], static_cast<std::uint16_t>(error));
      send(kError, body);
    }
    for (const Bytes& reply : replies) send(kCoe, reply);
  }

  void send(std::uint8_t type, const Bytes& body) {
    answered = answered % 7 + 1;
    Bytes message(kHeader, 0);
    put16(message.data(), static_cast<std::uint16_t>(body.size()));
    message[5] = static_cast<std::uint8_t>(type | answered << 4);
    message.insert(message.end(), body.begin(), body.end());
    waiting.push_back(std::move(message));
    fill();
  }
  void fill() {
    if (waiting.empty() || !managers.enabled(kIn) || managers.full(kIn)) return;
    newest = std::move(waiting.front());
    waiting.pop_front();
    put(newest);
  }
  void put(const Bytes& message) {
    const std::size_t size = std::min(message.size(), managers.length(kIn));
    std::fill_n(managers.area(kIn), managers.length(kIn), std::uint8_t{0});
    std::copy_n(message.begin(), size, managers.area(kIn));
    managers.set_full(kIn, true);
  }

  SyncManagers& managers;
  Coe coe;
  std::deque<Bytes> waiting;
  Bytes newest;
  int counted = 0;   // counter of the newest message from the master
  int answered = 0;  // and of ours
  bool repeated = false;
};

}  // namespace ethercat
