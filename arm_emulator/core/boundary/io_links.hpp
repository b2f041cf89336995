// The lines between controller and drives: commands and measurements as they come through.
#pragma once

#include <bit>

#include "arm.h"
#include "mechanics/scene.hpp"
#include "parts/line.hpp"

namespace arm {

// A scene without faults of lines: what is sent is received.
template <class S>
struct IoLinks {
  static constexpr bool present = false;
  std::int64_t newest_tick() const { return 0; }
  void restart(std::int64_t, const arm_measurement&) {}
  template <class Machine>
  void transmit_commands(const Machine&, std::int64_t, bool, arm_joint_command*, double*) {}
  template <class Machine>
  void transmit_measurement(const Machine&, std::int64_t, arm_measurement&) {}
  void write_received(arm_measurement&) const {}
  template <class Number>
  void for_each_number(Number&&) {}
};

template <class S>
  requires requires(const double* p) { S::lines(p); }
class IoLinks<S> {
 public:
  static constexpr bool present = true;
  static constexpr int N = count_joints<S>();

  // Tick of the newest measurement.
  std::int64_t newest_tick() const { return newest_; }

  // As if the machine had always rested, enabled, under commands of 0.
  void restart(std::int64_t tick, const arm_measurement& measured) {
    newest_ = tick;
    for (int j = 0; j < N; ++j) {
      Command rest = {};
      rest[kCommand - 1] = ARM_ENABLED;
      commands_[j].restart(rest);
      Measured frame;
      pack(measured, j, frame);
      measurements_[j].restart(frame);
    }
  }

  // Replace the commands of a tick by those that the drives receive. `is_received`: these have come
  // through already.
  template <class Machine>
  void transmit_commands(const Machine& machine, std::int64_t tick, bool is_received,
                         arm_joint_command* joint, double* further) {
    const auto suite = evaluate_faults(machine);
    for (int j = 0; j < N; ++j) {
      if (!kLined.at[j]) continue;
      Command frame;
      const auto each = [&](auto&& word) {
        word(frame[0], joint[j].value);
        for (int r = 0; r < S::inputs; ++r) word(frame[1 + r], further[r * N + j]);
      };
      each([](std::int64_t& to, double from) { to = std::bit_cast<std::int64_t>(from); });
      const std::uint64_t mode = static_cast<std::uint32_t>(joint[j].mode);
      frame[kCommand - 1] = static_cast<std::int64_t>(mode << 32 | joint[j].enable);
      static constexpr LineFaults none;
      commands_[j].send(tick, frame, is_received ? none : suite.at[j].command, noises(suite, j, 0),
                        flip_bit_of_number);
      for (int w = 0; w < kCommand; ++w) frame[w] = commands_[j].received()[w];
      each([](const std::int64_t& from, double& to) { to = std::bit_cast<double>(from); });
      const auto last = static_cast<std::uint64_t>(frame[kCommand - 1]);
      joint[j].mode = static_cast<std::int32_t>(last >> 32);
      joint[j].enable = suite.at[j].silent >= 0.5 ? 0 : static_cast<std::uint32_t>(last);
    }
  }

  // Send the measurement of a tick, of which no array is null.
  template <class Machine>
  void transmit_measurement(const Machine& machine, std::int64_t tick, arm_measurement& measured) {
    newest_ = tick;
    const auto suite = evaluate_faults(machine);
    for (int j = 0; j + 1 < N; ++j)
      if (suite.at[j].swapped >= 0.5) swap_encoders(measured, j, j + 1);
    for (int j = 0; j < N; ++j) {
      if (!kLined.at[j]) continue;
      Measured frame;
      pack(measured, j, frame);
      measurements_[j].send(tick, frame, suite.at[j].measurement, noises(suite, j, 1),
                            flip_bit_of_count);
    }
  }

  // Replace a measurement by the received one; its arrays may be null.
  void write_received(arm_measurement& out) const {
    for (int j = 0; j < N; ++j) {
      if (!kLined.at[j]) continue;
      const Measured& frame = measurements_[j].received();
      for_each_word(out, j, [&](int k, auto& to) { assign(to, frame[k]); });
    }
  }

  template <class Number>
  void for_each_number(Number&& number) {
    number(newest_);
    for (int j = 0; j < N; ++j)
      commands_[j].for_each_number(number), measurements_[j].for_each_number(number);
  }

 private:
  // Joints whose lines may have faults.
  struct Lined {
    bool at[N] = {};
    constexpr Lined() {
      const auto suite = S::lines(SomeValues<S>().p);
      for (int j = 0; j < N; ++j) {
        at[j] |= suite.at[j].can_fail();
        if (j + 1 < N && suite.at[j].swapped != 0.0) at[j + 1] = true;
      }
    }
  };
  static constexpr Lined kLined = {};

  static constexpr int kCommand = 2 + S::inputs;
  static constexpr int kMeasured = 11 + S::readings;
  using Command = typename LineDirection<kCommand>::Frame;
  using Measured = typename LineDirection<kMeasured>::Frame;

  template <class Machine>
  static auto evaluate_faults(const Machine& machine) {
    double values[S::parameters + 1] = {};
    for (int k = 0; k < S::parameters; ++k) values[k] = machine.parameter(k);
    return S::lines(values);
  }
  // Streams apart from those of sensors.
  template <class Suite>
  static Noise noises(const Suite& suite, int j, int way) {
    return Noise::make_stream(suite.seed, -(1 << 29) - 2 * j - way);
  }

  // Turn over the sign of a number, or one of the 23 leading bits of its fraction: it stays finite.
  static void flip_bit_of_number(Command& frame, double draw) {
    const int bit = static_cast<int>(24.0 * draw - 1e-9);
    frame[0] ^= std::int64_t{1} << (bit < 1 ? 63 : 52 - bit);
  }
  // Turn over one of the 16 last bits of counts.
  static void flip_bit_of_count(Measured& frame, double draw) {
    frame[0] ^= std::int64_t{1} << static_cast<int>(16.0 * draw - 1e-9);
  }

  static void swap_encoders(arm_measurement& measured, int j, int neighbour) {
    const auto exchange = [](auto& a, auto& b) {
      const auto first = a;
      a = b, b = first;
    };
    exchange(measured.joint[j].encoder, measured.joint[neighbour].encoder);
    arm_joint_sensors &a = measured.sensors[j], &b = measured.sensors[neighbour];
    const double torques[] = {a.torque, b.torque};
    exchange(a, b);
    a.torque = torques[0], b.torque = torques[1];
  }

  static void pack(const arm_measurement& measured, int j, Measured& frame) {
    for_each_word(measured, j, [&](int k, const auto& from) { frame[k] = word_of(from); });
  }
  static std::int64_t word_of(std::int64_t value) { return value; }
  static std::int64_t word_of(std::uint32_t value) { return value; }
  static std::int64_t word_of(double value) { return std::bit_cast<std::int64_t>(value); }
  static void assign(std::int64_t& to, std::int64_t word) { to = word; }
  static void assign(std::uint32_t& to, std::int64_t word) {
    to = static_cast<std::uint32_t>(word);
  }
  static void assign(double& to, std::int64_t word) { to = std::bit_cast<double>(word); }

  // word(index, number) for all of joint j that is there. What the motors got is left out: a run is
  // repeated from it.
  template <class Word>
  static void for_each_word(const arm_measurement& of, int j, Word&& word) {
    int k = 0;
    const auto each = [&](auto&... numbers) { (word(k++, numbers), ...); };
    arm_joint_measurement& joint = of.joint[j];
    each(joint.encoder, joint.current, joint.faults, joint.brake);
    if (of.sensors) {
      arm_joint_sensors& s = of.sensors[j];
      each(s.index, s.index_pulses, s.link_encoder, s.link_index, s.link_index_pulses, s.torque);
    }
    k = 10;
    if (of.current_d) each(of.current_d[j]);
    k = 11;
    for (int r = 0; of.readings && r < S::readings; ++r) each(of.readings[r * N + j]);
  }

  std::int64_t newest_ = 0;
  LineDirection<kCommand> commands_[N];
  LineDirection<kMeasured> measurements_[N];
};

}  // namespace arm
