// Random and mutated frames for a segment, in the same unit. Behind ethercat.cpp.
#include <cstdio>
#include <cstring>

namespace {

// Numbers that look random (splitmix64).
struct Random {
  std::uint64_t state;
  std::uint64_t operator()() {
    std::uint64_t z = state += 0x9e3779b97f4a7c15u;
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9u;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebu;
    return z ^ (z >> 31);
  }
};

// A master that brings slaves up, and keeps its frames, so that they can be spoiled.
class Fuzzer {
 public:
  Fuzzer(ethercat_segment* segment, std::uint64_t seed, int slaves)
      : segment(segment), random{seed}, slaves(slaves) {}

  // Returns how many of `count` frames were sound; -1: something was wrong, see `why`.
  std::int64_t run(std::int64_t count) {
    const std::int64_t before = sound();
    bring_up();
    for (std::int64_t k = 0; k < count && !why[0]; ++k) {
      if (k % 1000 == 999) bring_up();
      next();
    }
    return why[0] ? -1 : sound() - before;
  }
  char why[200] = {};

 private:
  std::int64_t sound() const { return segment->figures().frames; }
  std::uint64_t draw(std::uint64_t below) { return random() % below; }

  void begin() {
    std::memset(frame, 0xff, 6);
    std::memset(frame + 6, 2, 6);
    frame[12] = 0x88, frame[13] = 0xa4;
    size = 16;
    last = nullptr;
  }
  void add(int command, std::uint32_t address, const void* data, std::size_t length) {
    if (last) last[7] |= 0x80;
    last = frame + size;
    last[0] = static_cast<std::uint8_t>(command), last[1] = 0;
    ethercat::put32(last + 2, address);
    ethercat::put16(last + 6, static_cast<std::uint16_t>(length));
    ethercat::put16(last + 8, 0);
    std::memcpy(last + 10, data, length);
    ethercat::put16(last + 10 + length, 0);
    size += 12 + length;
    ethercat::put16(frame + 14, static_cast<std::uint16_t>(0x1000 | (size - 16)));
  }
  // Lets a copy through that is as large as it is, so that AddressSanitizer sees its end.
  void send(std::size_t length) {
    const std::unique_ptr<std::uint8_t[]> exact(new std::uint8_t[length]);
    std::memcpy(exact.get(), frame, length);
    const bool is_sound = ethercat::check({exact.get(), length}) == ethercat::FrameCheck::SOUND;
    const ethercat_figures was = segment->figures();
    std::vector<ethercat::Memory> before;
    for (int k = 0; !is_sound && k < slaves; ++k) before.push_back(contents(k));
    now += 1'000'000;
    const std::int64_t back =
        ethercat_frame(segment, exact.get(), static_cast<std::int64_t>(length), now);
    const ethercat_figures is = segment->figures();
    const auto counted = [](const ethercat_figures& f) {
      return f.frames + f.malformed + f.foreign + f.circulating;
    };
    if (back != 0 && back != static_cast<std::int64_t>(length)) no("a frame has another length");
    if (counted(is) != counted(was) + 1) no("a frame is not counted once");
    if ((is.frames != was.frames) != is_sound)
      no("a frame is carried out that is not sound, or not");
    for (int k = 0; !is_sound && k < slaves; ++k) {
      ethercat::Memory after = contents(k);
      after.put8(ethercat::reg::kUnitErrors, before[k].get8(ethercat::reg::kUnitErrors));
      if (std::memcmp(after.at(0), before[k].at(0), ethercat::kMemory)) no("it changed a slave");
    }
    if (!is_sound && is.periods != was.periods) no("it made time pass");
    for (int k = 0; k < slaves; ++k) {
      const int state = contents(k).get16(ethercat::reg::kAlStatus) & 15;
      if (state != 1 && state != 2 && state != 4 && state != 8) no("an unknown state");
    }
  }
  const ethercat::Memory& contents(int k) const {
    return segment->slave(static_cast<std::size_t>(k)).contents();
  }
  void no(const char* what) { std::snprintf(why, sizeof why, "%s", what); }

  static std::uint32_t at(int station, std::uint32_t offset) {
    return static_cast<std::uint32_t>(station) | offset << 16;
  }
  void write(int slave, std::uint32_t offset, const void* data, std::size_t length) {
    begin();
    add(5, at(0x1001 + slave, offset), data, length);
    send(size);
  }
  void write16(int slave, std::uint32_t offset, std::uint16_t value) {
    std::uint8_t bytes[2];
    ethercat::put16(bytes, value);
    write(slave, offset, bytes, 2);
  }

  void bring_up() {
    for (int k = 0; k < slaves; ++k) {
      const std::uint8_t control[4] = {1, 0, 0, 0},
                         station[2] = {static_cast<std::uint8_t>(1 + k), 0x10};
      for (int port = 0; port <= k; ++port) {  // what closed a port must not stay
        begin();
        add(2, at(-port & 0xffff, 0x0100), control, 4);
        send(size);
      }
      begin();
      add(2, at(-k & 0xffff, 0x0010), station, 2);
      send(size);
      write16(k, 0x0120, 0x11);
      const std::uint8_t off[64] = {};
      write(k, 0x0800, off, 64);
      write(k, 0x0980, off, 4);
      const std::uint8_t guards[16] = {0x00, 0x10, 128, 0, 0x26, 0, 1, 0,
                                       0x00, 0x11, 128, 0, 0x22, 0, 1, 0};
      write(k, 0x0800, guards, 16);
      if (draw(8) == 0) continue;  // now and then it stays in INIT
      write16(k, 0x0120, 2);
      if (draw(8) == 0) continue;
      for (const bool outputs : {true, false}) {
        const auto bytes = static_cast<std::uint8_t>(mapped(k, outputs));
        const std::uint8_t guard[8] = {0,
                                       static_cast<std::uint8_t>(outputs ? 0x12 : 0x15),
                                       bytes,
                                       0,
                                       static_cast<std::uint8_t>(outputs ? 0x64 : 0x20),
                                       0,
                                       1,
                                       0};
        write(k, outputs ? 0x0810 : 0x0818, guard, 8);
        std::uint8_t unit[16] = {};
        ethercat::put32(unit, static_cast<std::uint32_t>(64 * k + (outputs ? 0 : 32)));
        unit[4] = bytes, unit[7] = 7, unit[9] = guard[1], unit[11] = outputs ? 2 : 1, unit[12] = 1;
        write(k, outputs ? 0x0600 : 0x0610, unit, 16);
      }
      write16(k, 0x0120, 4);
    }
    exchange();
    for (int k = 0; k < slaves; ++k)
      if (draw(8) != 0) write16(k, 0x0120, 8);
    exchange();
  }
  void exchange() {
    std::uint8_t data[512] = {};
    begin();
    add(12, 0, data, 64 * static_cast<std::size_t>(slaves));
    send(size);
  }
  std::size_t mapped(int slave, bool outputs) const {
    const ethercat::Door door(all, slave);
    std::size_t bits = 0;
    const std::uint16_t assignment = outputs ? 0x1c12 : 0x1c13;
    for (std::uint32_t p = 1; p <= door.number(assignment, 0); ++p) {
      const auto pdo =
          static_cast<std::uint16_t>(door.number(assignment, static_cast<std::uint8_t>(p)));
      for (std::uint32_t e = 1; e <= door.number(pdo, 0); ++e)
        bits += door.number(pdo, static_cast<std::uint8_t>(e)) & 0xff;
    }
    return bits / 8;
  }

  // ------------------------------------------------------------------------- frames of any shape

  void next() {
    begin();
    switch (draw(10)) {
      case 0:  // bytes
        size = draw(200) < 190 ? draw(120) : draw(sizeof frame);
        for (std::size_t k = 0; k < size; ++k) frame[k] = static_cast<std::uint8_t>(random());
        break;
      case 1:  // bytes of the right protocol
        size = 16 + draw(200);
        for (std::size_t k = 14; k < size; ++k) frame[k] = static_cast<std::uint8_t>(random());
        ethercat::put16(frame + 14, static_cast<std::uint16_t>(0x1000 | (size - 16)));
        break;
      case 2:
      case 3:
        mail();
        break;
      case 4: {  // process data
        std::uint8_t data[512];
        for (std::uint8_t& byte : data) byte = static_cast<std::uint8_t>(random());
        add(10 + static_cast<int>(draw(3)), static_cast<std::uint32_t>(draw(64)), data,
            64 + draw(400));
        break;
      }
      default:
        for (std::uint64_t k = 1 + draw(4); k > 0; --k) any_datagram();
    }
    std::size_t length = size;
    if (draw(3) == 0) {  // spoil it
      for (std::uint64_t k = 1 + draw(4); k > 0 && length > 0; --k) switch (draw(4)) {
          case 0:
            frame[draw(length)] = static_cast<std::uint8_t>(random());
            break;
          case 1:
            frame[draw(length)] ^= static_cast<std::uint8_t>(1u << draw(8));
            break;
          case 2:
            length = draw(length + 1);
            break;
          default:
            length = std::min(sizeof frame, length + draw(64));
            break;
        }
    }
    send(length);
  }
  void any_datagram() {
    static constexpr std::uint16_t kPlaces[] = {
        0x0000, 0x0010, 0x0040, 0x0100, 0x0103, 0x0110, 0x0120, 0x0130, 0x0200, 0x0210,
        0x0300, 0x0400, 0x0420, 0x0440, 0x0500, 0x0502, 0x0508, 0x0600, 0x0610, 0x0620,
        0x0800, 0x0805, 0x0806, 0x0808, 0x080e, 0x0810, 0x0818, 0x0820, 0x0900, 0x0910,
        0x0920, 0x092c, 0x0980, 0x0990, 0x09a0, 0x0f80, 0x0fff, 0x1000, 0x107f, 0x1100,
        0x10ff, 0x117f, 0x1200, 0x1500, 0x2fff, 0x3000, 0xffff};
    std::uint8_t data[300];
    for (std::uint8_t& byte : data) byte = static_cast<std::uint8_t>(draw(3) ? random() : draw(16));
    const std::size_t length = draw(20) ? draw(20) : draw(sizeof data);
    const int command = static_cast<int>(draw(16));
    std::uint32_t offset = kPlaces[draw(std::size(kPlaces))] + (draw(4) ? 0 : draw(8));
    if (draw(10) == 0) offset = static_cast<std::uint32_t>(draw(0x10000));
    const int position = draw(2) ? 0x1001 + static_cast<int>(draw(slaves + 1))
                                 : -static_cast<int>(draw(slaves + 1)) & 0xffff;
    add(command, draw(20) ? at(position, offset & 0xffff) : static_cast<std::uint32_t>(random()),
        data, length);
  }
  // A message of the mailbox: mostly a request that could be one. Then the answer is read.
  void mail() {
    std::uint8_t message[128] = {};
    for (std::uint8_t& byte : message) byte = static_cast<std::uint8_t>(draw(2) ? random() : 0);
    const std::size_t body = draw(8) ? 10 + draw(8) : draw(123);
    ethercat::put16(message, static_cast<std::uint16_t>(draw(12) ? body : random()));
    message[5] = static_cast<std::uint8_t>((draw(12) ? 3 : draw(16)) | draw(8) << 4);
    message[7] = static_cast<std::uint8_t>((draw(8) ? (draw(4) ? 2 : 8) : draw(16)) << 4);
    static constexpr std::uint8_t kCommands[] = {0x40, 0x50, 0x23, 0x27, 0x2b, 0x2f,
                                                 0x21, 0x31, 0x60, 0x70, 0x00, 0x10,
                                                 0x01, 0x11, 0x80, 1,    3,    5};
    if (draw(8)) message[8] = kCommands[draw(std::size(kCommands))];
    if (draw(8)) {
      const std::uint16_t index = indices[draw(indices.size())];
      const bool information = message[7] >> 4 == 8;
      ethercat::put16(message + (information ? 12 : 9), index);
      message[information ? 14 : 11] = static_cast<std::uint8_t>(draw(6));
    }
    if (draw(2)) ethercat::put32(message + 12, static_cast<std::uint32_t>(draw(200)));
    const int slave = static_cast<int>(draw(slaves));
    std::uint8_t answer[128] = {};
    add(5, at(0x1001 + slave, 0x1000), message, 128);
    if (draw(8)) add(4, at(0x1001 + slave, 0x1100), answer, 128);
  }

  ethercat_segment* segment;
  Random random;
  int slaves;
  const std::vector<std::uint16_t> indices = ethercat::all_objects();
  std::uint8_t frame[1700];
  std::size_t size = 16;
  std::uint8_t* last = nullptr;
  std::int64_t now = 0;

 public:
  drives* all = nullptr;
};

}  // namespace

#pragma GCC visibility push(default)

// Returns how many of `count` frames, and those that bring slaves up, were sound; -1 with the
// reason in `why` (200 bytes).
extern "C" std::int64_t ethercat_fuzz(ethercat_segment* segment, drives* all, std::uint64_t seed,
                                      std::int64_t count, char* why) {
  Fuzzer fuzzer(segment, seed, drives_count(all));
  fuzzer.all = all;
  const std::int64_t sound = fuzzer.run(count);
  std::memcpy(why, fuzzer.why, sizeof fuzzer.why);
  return sound;
}

#pragma GCC visibility pop
