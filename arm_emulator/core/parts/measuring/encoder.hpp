// An encoder: counts of a disc on a shaft.
//
//   alpha = theta + offset + eccentricity sin(t + eccentricity_phase)
//         + ripple sin(ripple_order t + ripple_phase) + noise n,   t the angle theta as 2 pi a turn
//   c = floor(alpha counts_per_turn / turn)
//
// An incremental one counts edges up and down, so that an edge that is missed stays missed; an
// index pulse once a turn gives what the counter should be. An absolute one reads the word c mod
// 2^bits.
#pragma once

#include <cstdint>

#include "numerics/noise.hpp"

namespace arm {

enum class EncoderKind { none, incremental, absolute };
// Effect of an index pulse: none, its counts are reported, or the counter is corrected, too.
enum class Index { none, latch, correct };

// An angle that is below an edge by less than this is on it [counts]: of an arm that rests on an
// edge, as many do at 0, rounding of either sign gives the same count.
inline constexpr double kOnAnEdge = 1e-9;

struct EncoderReading {
  std::int64_t counts = 0;
  std::int64_t index = 0;   // what the counter was when the newest index pulse came
  std::int64_t pulses = 0;  // that came

  template <class Number>
  void for_each_number(Number&& number) {
    number(counts), number(index), number(pulses);
  }
};

struct Encoder {
  EncoderKind kind = EncoderKind::none;
  double counts_per_turn = 1.0;
  double counts_per_rad = 1.0;  // of the shaft; per m of a linear scale
  double turns_per_rad = 1.0;   // 1 / 2 pi, or 1 of a linear scale
  Index index = Index::none;
  int bits = 0;               // of an absolute encoder's word
  int delay = 0;              // servo periods
  double ripple_order = 0.0;  // per turn
  double offset = 0.0;
  double eccentricity = 0.0, eccentricity_phase = 0.0;
  double ripple = 0.0, ripple_phase = 0.0;
  double noise = 0.0;   // rad, standard deviation
  double missed = 0.0;  // probability of each edge to be missed, or of a word not to come
  double held = 0.0;    // probability that a sample repeats the reading before
  double flips = 0.0;   // that a bit of a reading is wrong

  // Counts after which a word starts at 0 again; 0: never.
  constexpr std::int64_t wrap() const {
    return kind == EncoderKind::absolute ? std::int64_t{1} << bits : 0;
  }

  // Counts of the disc at the shaft's angle theta, at the sample of that number.
  std::int64_t count_on_disc(double theta, const Noise& noises, std::int64_t number) const {
    double alpha = theta + offset;
    const double t = 6.283185307179586 * turns_per_rad * theta;
    if (eccentricity != 0.0) alpha += eccentricity * sincos(t + eccentricity_phase).sin;
    if (ripple != 0.0) alpha += ripple * sincos(ripple_order * t + ripple_phase).sin;
    if (noise != 0.0) alpha += noise * noises.normal(number);
    return static_cast<std::int64_t>(
        clamp(__builtin_floor(alpha * counts_per_rad + kOnAnEdge), 0x1p60));
  }
};

// State of an encoder between samples.
struct EncoderMemory {
  EncoderReading now;
  std::int64_t disc = 0;    // counts of the disc
  std::int64_t lost = 0;    // counts that the counter has missed
  std::int64_t misses = 0;  // that were drawn
  double until_miss = 0.0;  // budget until an edge is missed, see `pass`

  template <class Number>
  void for_each_number(Number&& number) {
    now.for_each_number(number);
    number(disc), number(lost), number(misses), number(until_miss);
  }

  // Start at the shaft's angle, with no missed counts; or, after the machine was moved by hand,
  // with those of before.
  void restart(const Encoder& e, double theta, const Noise& noises, std::int64_t number,
               bool resets) {
    if (resets) {
      *this = {};
      until_miss = miss_stream(noises).exponential(0);
    }
    disc = e.count_on_disc(theta, noises, number);
    update_reading(e);
  }

  void measure(const Encoder& e, double theta, const Noise& noises, std::int64_t number) {
    const std::int64_t c = e.count_on_disc(theta, noises, number);
    if (e.kind == EncoderKind::absolute) {
      disc = c;
      if (e.missed > 0.0 && miss_stream(noises).uniform(number) <= e.missed) return;
    } else {
      count_to(e, c, noises);
    }
    if (repeats_reading(e.held, noises, number)) return;
    update_reading(e);
    const Noise flips = {mix_bits(noises.key + 2)};
    if (e.flips > 0.0 && flips.uniform(2 * number) <= e.flips)
      flip_bit(e, flips.uniform(2 * number + 1));
  }

 private:
  static constexpr int kMaxMisses = 1000;  // that are drawn one by one between two samples

  static constexpr Noise miss_stream(const Noise& noises) {
    return {mix_bits(noises.key ^ kGolden)};
  }

  void update_reading(const Encoder& e) {
    const std::uint64_t word = (std::uint64_t{1} << e.bits) - 1;
    const bool absolute = e.kind == EncoderKind::absolute;
    now.counts =
        absolute ? static_cast<std::int64_t>(static_cast<std::uint64_t>(disc) & word) : disc - lost;
  }

  // Turn one bit of the reading over: of a word any, of a counter one of the last 16.
  void flip_bit(const Encoder& e, double draw) {
    const int bits = e.kind == EncoderKind::absolute ? e.bits : 16;
    now.counts ^= std::int64_t{1} << static_cast<int>(bits * draw - 1e-9);
  }

  // Count the edges up to c. The newest index pulse on the way falls on a multiple of a turn.
  void count_to(const Encoder& e, std::int64_t c, const Noise& noises) {
    const auto per_turn = static_cast<std::int64_t>(e.counts_per_turn);
    const std::int64_t from = floor_turns(disc, per_turn), to = floor_turns(c, per_turn);
    if (e.index != Index::none && from != to) {
      const std::int64_t pulse = (c > disc ? to : to + 1) * per_turn;
      count_edges(e, pulse, noises);
      now.index = disc - lost;
      now.pulses += from < to ? to - from : from - to;
      if (e.index == Index::correct) lost = per_turn * floor_turns(lost + per_turn / 2, per_turn);
    }
    count_edges(e, c, noises);
  }

  // Each edge uses `rate` of a budget; an edge is missed when it is used up. Budgets are
  // exponentially distributed, so edges are missed independently with probability 1 - exp(-rate) =
  // e.missed, also when that changes.
  void count_edges(const Encoder& e, std::int64_t to, const Noise& noises) {
    const std::int64_t direction = to > disc ? 1 : -1;
    double edges = static_cast<double>(direction * (to - disc));
    disc = to;
    if (e.missed <= 0.0) return;
    const double rate = 2.0 * artanh(e.missed / (2.0 - e.missed));  // -log(1 - e.missed)
    for (int k = 0; k < kMaxMisses; ++k) {
      double next = __builtin_ceil(until_miss / rate);
      if (next < 1.0) next = 1.0;
      if (next > edges) {
        until_miss -= edges * rate;
        return;
      }
      edges -= next;
      lost += direction;
      until_miss = miss_stream(noises).exponential(++misses);
    }
    lost +=
        direction * static_cast<std::int64_t>(edges * e.missed);  // of so many, as many as expected
  }

  static constexpr std::int64_t floor_turns(std::int64_t counts, std::int64_t per_turn) {
    const std::int64_t turn = counts / per_turn;
    return turn * per_turn > counts ? turn - 1 : turn;
  }
};

}  // namespace arm
