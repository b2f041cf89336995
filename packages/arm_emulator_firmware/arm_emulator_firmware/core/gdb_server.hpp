// gdb's remote protocol on a socket: registers, memory, breakpoints, continue, step, interrupt. It
// runs in the firmware's thread; nothing else runs while that is halted.
#pragma once

#include <netinet/in.h>
#include <netinet/tcp.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <cstdint>
#include <cstdlib>
#include <iterator>
#include <set>
#include <string>
#include <string_view>
#include <vector>

namespace mcu {

// `Chip`: what is debugged, see `Runner`.
template <class Chip>
class GdbServer {
 public:
  // `socket` listens; this waits for a client.
  GdbServer(Chip& debugged, int socket) : debugged_(debugged) {
    client_ = ::accept(socket, nullptr, nullptr);
    const int at_once = 1;  // answers are short, and each is waited for
    ::setsockopt(client_, IPPROTO_TCP, TCP_NODELAY, &at_once, sizeof at_once);
  }
  GdbServer(const GdbServer&) = delete;
  GdbServer& operator=(const GdbServer&) = delete;
  ~GdbServer() {
    if (client_ < 0) return;
    if (!halted_) send("W00");
    ::close(client_);
  }

  // Before every instruction: halt if requested, until the debugger continues. Returns false to end
  // the run.
  bool serve_debugger(bool at_stop) {
    if (client_ < 0) return !killed_;
    if (!halted_) {
      if (stepped_ || (at_stop && moved_))
        halt(5);
      else if (is_interrupt_requested())
        halt(2);
    }
    while (halted_ && client_ >= 0) serve();
    return !killed_;
  }

  // Halt before the next instruction, as at a breakpoint.
  void halt_here() {
    if (client_ >= 0 && !halted_) halt(5);
  }

  // Whether to run a single instruction.
  bool steps() const { return stepping_; }
  // The firmware has run.
  void report_run() {
    moved_ = true;
    stepped_ = stepping_;
  }
  // The firmware cannot continue: report the reason until the debugger ends.
  void report_end() {
    if (client_ < 0) return;
    halt(11);
    while (halted_ && client_ >= 0) serve();
  }

 private:
  // gdb's: core, then d0 to d15, then those of one word that follow.
  static constexpr int REGISTERS = 17, DOUBLES = 16;
  static constexpr const char* WORDS[] = {"fpscr",   "msp",       "psp",    "primask",
                                          "basepri", "faultmask", "control"};
  static constexpr int FIRST_WORD = REGISTERS + DOUBLES, ALL = FIRST_WORD + std::size(WORDS);
  // The first of a register's words, as the chip numbers them.
  static int place_of(int number) {
    if (number < REGISTERS) return number;
    if (number < FIRST_WORD) return REGISTERS + 2 * (number - REGISTERS);
    return number - FIRST_WORD + REGISTERS + 2 * DOUBLES;
  }
  static int count_words(int number) { return number >= REGISTERS && number < FIRST_WORD ? 2 : 1; }

  void halt(int signal) {
    halted_ = true;
    stepping_ = stepped_ = false;
    signal_ = signal;
    if (asked_to_go_) send(stop_reply());
  }

  void go(bool step) {
    halted_ = moved_ = stepped_ = false;
    stepping_ = step;
    asked_to_go_ = true;
  }

  void leave() {
    ::close(client_);
    client_ = -1;
    halted_ = stepping_ = false;
    debugged_.set_stops({});
  }

  std::string stop_reply() const {
    std::string reply = "S";
    put_byte(reply, static_cast<uint8_t>(signal_));
    return reply;
  }

  // Whether Ctrl-C was pressed; while it runs, gdb sends nothing else that counts.
  bool is_interrupt_requested() {
    while (at_ < buffered_.size() || fill(MSG_DONTWAIT))
      if (buffered_[at_++] == 3) return true;
    return false;
  }

  bool fill(int how) {
    char some[4096];
    const ssize_t size = ::recv(client_, some, sizeof some, how);
    if (size <= 0) return false;
    buffered_.assign(some, static_cast<size_t>(size));
    at_ = 0;
    return true;
  }

  int read_byte() {
    if (at_ == buffered_.size() && !fill(0)) return -1;
    return static_cast<uint8_t>(buffered_[at_++]);
  }

  // Take one packet and answer it.
  void serve() {
    int one = read_byte();
    if (one < 0) return leave();
    if (one == 3) return send(stop_reply());
    if (one != '$') return;
    std::string packet;
    uint8_t sum = 0;
    while ((one = read_byte()) >= 0 && one != '#') {
      sum = static_cast<uint8_t>(sum + one);
      if (one == '}') {
        one = read_byte();
        sum = static_cast<uint8_t>(sum + one);
        one ^= 0x20;
      }
      if (packet.size() < MAX_PACKET) packet.push_back(static_cast<char>(one));
    }
    const int high = read_byte(), low = read_byte();
    if (one < 0 || low < 0) return leave();
    const bool sound = parse_digit(high) * 16 + parse_digit(low) == sum;
    send_raw(sound ? "+" : "-");
    if (sound) answer(packet);
  }

  void answer(const std::string& packet) {
    const char kind = packet.empty() ? 0 : packet[0];
    const char* rest = packet.c_str() + (kind != 0);
    switch (kind) {
      case '?':
        return send(stop_reply());
      case 'g':
        return send(all_registers());
      case 'G':
        return set_all(rest);
      case 'p':
        return send(format_register(std::strtoul(rest, nullptr, 16)));
      case 'P':
        return set_one(rest);
      case 'm':
        return send(memory(rest));
      case 'M':
        return send(set_memory(rest) ? "OK" : "E01");
      case 'c':
        return go(false);
      case 's':
        return go(true);
      case 'Z':
      case 'z':
        return send(set_stop(kind == 'Z', rest));
      case 'H':
      case 'T':
        return send("OK");
      case 'D':
        send("OK");
        return leave();
      case 'k':
        killed_ = true;
        return leave();
      case 'q':
        return send(query(packet));
      case 'v':
        if (packet == "vCont?") return send("vCont;c;C;s;S");
        if (packet.starts_with("vCont;")) return go(packet[6] == 's' || packet[6] == 'S');
        if (packet.starts_with("vKill")) {
          killed_ = true;
          send("OK");
          return leave();
        }
        return send("");
      default:
        return send("");
    }
  }

  static std::string query(std::string_view packet) {
    if (packet.starts_with("qSupported"))
      return "PacketSize=1000;qXfer:features:read+;vContSupported+";
    if (packet == "qAttached") return "1";
    if (packet == "qC") return "QC1";
    if (packet == "qfThreadInfo") return "m1";
    if (packet == "qsThreadInfo") return "l";
    constexpr std::string_view features = "qXfer:features:read:target.xml:";
    if (packet.starts_with(features)) {
      char* end = nullptr;
      const std::string where(packet.substr(features.size()));
      const size_t from = std::strtoul(where.c_str(), &end, 16);
      const size_t size = *end ? std::strtoul(end + 1, nullptr, 16) : 0;
      const std::string xml = describe_target();
      if (from >= xml.size()) return "l";
      return (from + size < xml.size() ? "m" : "l") + xml.substr(from, size);
    }
    return "";
  }

  static std::string describe_target() {
    std::string xml =
        "<?xml version=\"1.0\"?><!DOCTYPE target SYSTEM \"gdb-target.dtd\"><target>"
        "<architecture>arm</architecture><feature name=\"org.gnu.gdb.arm.m-profile\">";
    for (int k = 0; k < 13; ++k) xml += "<reg name=\"r" + std::to_string(k) + "\" bitsize=\"32\"/>";
    xml +=
        "<reg name=\"sp\" bitsize=\"32\" type=\"data_ptr\"/><reg name=\"lr\" bitsize=\"32\"/>"
        "<reg name=\"pc\" bitsize=\"32\" type=\"code_ptr\"/><reg name=\"xpsr\" bitsize=\"32\"/>"
        "</feature><feature name=\"org.gnu.gdb.arm.vfp\">";
    for (int k = 0; k < DOUBLES; ++k)
      xml += "<reg name=\"d" + std::to_string(k) + "\" bitsize=\"64\" type=\"ieee_double\"/>";
    xml += "<reg name=\"fpscr\" bitsize=\"32\" type=\"int\" group=\"float\"/></feature>";
    xml += "<feature name=\"org.gnu.gdb.arm.m-system\">";
    for (size_t k = 1; k < std::size(WORDS); ++k)
      xml += std::string("<reg name=\"") + WORDS[k] + "\" bitsize=\"32\" type=\"" +
             (k < 3 ? "data_ptr" : "int") + "\" group=\"system\"/>";
    return xml + "</feature></target>";
  }

  std::string format_register(size_t number) const {
    if (number >= static_cast<size_t>(ALL)) return "E01";
    std::string out;
    const int one = static_cast<int>(number);
    for (int k = 0; k < count_words(one); ++k)
      put_word(out, debugged_.get_register(place_of(one) + k));
    return out;
  }

  std::string all_registers() const {
    std::string out;
    for (size_t k = 0; k < static_cast<size_t>(ALL); ++k) out += format_register(k);
    return out;
  }

  void set_all(const char* text) {
    const std::vector<uint8_t> bytes = take_bytes(text);
    const size_t words = std::min<size_t>(bytes.size() / 4, place_of(ALL));
    for (size_t k = 0; k < words; ++k)
      debugged_.set_register(static_cast<int>(k), read_word_of(&bytes[4 * k]));
    send("OK");
  }

  void set_one(const char* text) {
    char* end = nullptr;
    const size_t number = std::strtoul(text, &end, 16);
    const std::vector<uint8_t> bytes = take_bytes(*end == '=' ? end + 1 : end);
    const int one = number < static_cast<size_t>(ALL) ? static_cast<int>(number) : ALL;
    if (one == ALL || bytes.size() != 4u * static_cast<size_t>(count_words(one)))
      return send("E01");
    for (int k = 0; k < count_words(one); ++k)
      debugged_.set_register(place_of(one) + k, read_word_of(&bytes[4 * static_cast<size_t>(k)]));
    send("OK");
  }

  std::string memory(const char* text) const {
    char* end = nullptr;
    const uint32_t at = static_cast<uint32_t>(std::strtoul(text, &end, 16));
    const size_t size = *end == ',' ? std::strtoul(end + 1, nullptr, 16) : 0;
    std::string out;
    for (uint32_t k = 0; k < std::min<size_t>(size, MAX_PACKET / 2); ++k) {
      uint8_t one = 0;
      if (!debugged_.look(at + k, &one)) break;
      put_byte(out, one);
    }
    return out.empty() && size ? "E01" : out;
  }

  bool set_memory(const char* text) {
    char* end = nullptr;
    const uint32_t at = static_cast<uint32_t>(std::strtoul(text, &end, 16));
    if (*end != ',') return false;
    const size_t size = std::strtoul(end + 1, &end, 16);
    const std::vector<uint8_t> bytes = take_bytes(*end == ':' ? end + 1 : end);
    if (bytes.size() != size) return false;
    return bytes.empty() || debugged_.write_memory(at, bytes.data(), static_cast<uint32_t>(size));
  }

  std::string set_stop(bool on, const char* text) {
    if ((*text != '0' && *text != '1') || text[1] != ',') return "";  // watchpoints are not known
    const uint32_t at = static_cast<uint32_t>(std::strtoul(text + 2, nullptr, 16)) & ~1u;
    if (on)
      stops_.insert(at);
    else
      stops_.erase(at);
    debugged_.set_stops({stops_.begin(), stops_.end()});
    return "OK";
  }

  static int parse_digit(int c) {
    return c >= '0' && c <= '9'   ? c - '0'
           : c >= 'a' && c <= 'f' ? c - 'a' + 10
           : c >= 'A' && c <= 'F' ? c - 'A' + 10
                                  : -1;
  }
  static void put_byte(std::string& out, uint8_t value) {
    constexpr char DIGITS[] = "0123456789abcdef";
    out += DIGITS[value >> 4];
    out += DIGITS[value & 15];
  }
  static void put_word(std::string& out, uint32_t value) {
    for (int k = 0; k < 4; ++k) put_byte(out, static_cast<uint8_t>(value >> 8 * k));
  }
  static uint32_t read_word_of(const uint8_t* bytes) {
    return bytes[0] | bytes[1] << 8 | bytes[2] << 16 | static_cast<uint32_t>(bytes[3]) << 24;
  }
  static std::vector<uint8_t> take_bytes(const char* text) {
    std::vector<uint8_t> bytes;
    for (; parse_digit(text[0]) >= 0 && parse_digit(text[1]) >= 0; text += 2)
      bytes.push_back(static_cast<uint8_t>(parse_digit(text[0]) * 16 + parse_digit(text[1])));
    return bytes;
  }

  void send(const std::string& text) {
    uint8_t sum = 0;
    for (const char c : text) sum = static_cast<uint8_t>(sum + c);
    std::string packet = "$" + text + "#";
    put_byte(packet, sum);
    send_raw(packet);
  }
  void send_raw(std::string_view text) {
    while (!text.empty()) {
      const ssize_t sent = ::send(client_, text.data(), text.size(), MSG_NOSIGNAL);
      if (sent <= 0) return;
      text.remove_prefix(static_cast<size_t>(sent));
    }
  }

  static constexpr size_t MAX_PACKET = 0x1000;

  Chip& debugged_;
  int client_ = -1;
  bool halted_ = true, killed_ = false, asked_to_go_ = false;
  bool stepping_ = false, stepped_ = false, moved_ = false;
  int signal_ = 5;
  std::set<uint32_t> stops_;
  std::string buffered_;
  size_t at_ = 0;
};

}  // namespace mcu
