// The line between a controller and a joint's drive: a frame per servo period each way, disturbed
// with probabilities. It is perfect unless a fault makes it worse.
#pragma once

#include <cstdint>

#include "numerics/noise.hpp"

namespace arm {

struct LineFaults {
  double late = 0.0;       // servo periods, whole ones count
  double lost = 0.0;       // probability that a frame does not come, and the one before stands
  double repeated = 0.0;   // that the frame before comes once more, behind the newest
  double overtaken = 0.0;  // that a frame comes one period later, behind the one that follows it
  double corrupted = 0.0;  // that a bit is received wrong

  constexpr bool has_fault() const { return late + lost + repeated + overtaken + corrupted != 0.0; }
};

struct Line {
  LineFaults command, measurement;
  double silent = 0.0;   // 1: no command comes, and the drive is disabled
  double swapped = 0.0;  // 1: the plugs of its encoders and those of the next joint are swapped

  constexpr bool can_fail() const {
    return command.has_fault() || measurement.has_fault() || silent != 0.0 || swapped != 0.0;
  }
};

template <int joints>
struct LineSuite {
  double seed = 0.0;
  Line at[joints];
};

// One way of a line. A frame is `words` words of 64 bits.
template <int words>
class LineDirection {
 public:
  using Frame = std::int64_t[words];

  // As if this frame had always been sent.
  void restart(const Frame& frame) {
    for (Frame& frame_sent : sent_) copy(frame, frame_sent);
    copy(frame, received_);
  }

  // Send the frame of a tick; flip_bit(frame, draw) makes one bit wrong, draw is above 0 and at
  // most 1.
  template <class FlipBit>
  void send(std::int64_t tick, const Frame& frame, const LineFaults& faults, const Noise& noises,
            FlipBit&& flip_bit) {
    copy(frame, sent_[find_slot(tick)]);
    const auto occurs = [&](double probability, int who, std::int64_t of) {
      return probability > 0.0 && draw_number(noises, who, of) <= probability;
    };
    const std::int64_t due = tick - static_cast<std::int64_t>(faults.late);
    if (occurs(faults.lost, 0, tick)) return;
    const bool older = occurs(faults.overtaken, 1, tick - 1) || occurs(faults.repeated, 2, tick);
    if (!older && occurs(faults.overtaken, 1, tick)) return;
    copy(sent_[find_slot(older ? due - 1 : due)], received_);
    if (occurs(faults.corrupted, 3, tick)) flip_bit(received_, draw_number(noises, 4, tick));
  }

  const Frame& received() const { return received_; }

  template <class Number>
  void for_each_number(Number&& number) {
    for (Frame& frame_sent : sent_)
      for (std::int64_t& word : frame_sent) number(word);
    for (std::int64_t& word : received_) number(word);
  }

 private:
  static constexpr int kLongest = 16;           // periods by which a frame is late
  static constexpr int kLength = kLongest + 2;  // and one of before

  static int find_slot(std::int64_t tick) { return static_cast<int>((tick + kLength) % kLength); }
  static void copy(const Frame& from, Frame& to) {
    for (int k = 0; k < words; ++k) to[k] = from[k];
  }
  static double draw_number(const Noise& noises, int who, std::int64_t number) {
    return Noise{mix_bits(noises.key + static_cast<std::uint64_t>(who))}.uniform(number);
  }

  Frame sent_[kLength] = {};  // of the newest ticks, each at its tick modulo their number
  Frame received_ = {};
};

}  // namespace arm
