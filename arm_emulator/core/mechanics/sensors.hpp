// The sensors of a scene, and those of one machine: they measure at every tick and hold the
// readings until the next.
#pragma once

#include <tuple>
#include <utility>

#include "mechanics/imu.hpp"
#include "parts/measuring/encoder.hpp"

namespace arm {

// Place of a quantity in arm.h: a field of its own, or among the readings.
enum class Field { current, torque, reading };

// A machine at the moment at which sensors measure. Their classes state in Python what they read of
// it (`reads`), from which a scene's unit has a struct per kind: `field`, and `of(now, row)`. Here
// is with what was worked out for all sensors, by joint.
template <class Machine>
struct SensorInput {
  static constexpr int N = Machine::N;
  const Machine& machine;
  const double *current, *motor_angle, *motor_speed;  // A, rad, rad/s

  struct OfJoints {
    double of[N];
    double operator[](int j) const { return of[j]; }
  };
  // Torques of the gears on their links [N m or N].
  OfJoints gear_torques() const {
    OfJoints torques;
    machine.gear_torques(torques.of);
    return torques;
  }
  // Temperatures of the motors' windings [degC].
  OfJoints winding_temperatures() const {
    OfJoints temperatures;
    machine.winding_temperatures(temperatures.of);
    return temperatures;
  }
};

// Sensors of one quantity, one per joint. Sensors of a field that is always measured read it
// without errors where a joint has none.
template <class Measured, int N>
struct AnalogRow {
  using Quantity = Measured;
  static constexpr bool always = Quantity::field == Field::current;
  int first = 0, stride = 0;  // noise stream of joint j: first + stride j
  AnalogSensor at[N];

  constexpr bool has_reading(int j) const { return always || at[j].present; }
};

// Sensors of a scene. The motor's encoder is always present.
template <int joints, int imus, class... Quantities>
struct SensorSuite {
  static constexpr int N = joints, M = imus, K = sizeof...(Quantities);
  double seed = 0.0;
  Encoder encoder[N], link_encoder[N];
  std::tuple<AnalogRow<Quantities, N>...> analog;
  Imu imu[M + 1];

  constexpr int longest_delay() const {
    int longest = 0;
    const auto extend = [&](int delay) { longest = longest < delay ? delay : longest; };
    for (int j = 0; j < N; ++j) {
      extend(encoder[j].delay), extend(link_encoder[j].delay);
      std::apply([&](const auto&... row) { (extend(row.at[j].delay), ...); }, analog);
    }
    for (int m = 0; m < M; ++m) extend(imu[m].delay);
    return longest;
  }
};

// All readings of a tick; K: kinds of analog sensors.
template <int N, int M, int K>
struct SensorReadings {
  EncoderReading encoder[N], link_encoder[N];
  double analog[K][N] = {};
  ImuReading imu[M + 1];

  template <class Number>
  void for_each_number(Number&& number) {
    for (int j = 0; j < N; ++j)
      encoder[j].for_each_number(number), link_encoder[j].for_each_number(number);
    for (auto& row : analog)
      for (double& reading : row) number(reading);
    for (int m = 0; m < M; ++m) imu[m].for_each_number(number);
  }
};

// A scene without such sensors: the present values are measured.
template <class S>
class Sensors {
 public:
  static constexpr bool present = false;
  static constexpr int M = 0;

  template <class Machine>
  void restart(const Machine&, std::int64_t, bool) {}
  template <class Machine>
  void measure(const Machine&, std::int64_t) {}
  template <class Number>
  void for_each_number(Number&&) {}
};

template <class S>
  requires requires(const double* p) { S::sensors(p); }
class Sensors<S> {
 public:
  static constexpr bool present = true;
  static constexpr auto structure = S::sensors(SomeValues<S>().p);
  static constexpr int N = structure.N, M = structure.M, K = structure.K;
  using Readings = SensorReadings<N, M, K>;

  // Start at the machine's state at a tick, as if it had always rested there; with no missed counts
  // if `resets`.
  template <class Machine>
  void restart(const Machine& machine, std::int64_t tick, bool resets) {
    if (resets) drifted_ = {};
    measure_at_tick(machine, tick, false,
                    [&](EncoderMemory& memory, const Encoder& e, double theta, const Noise& n) {
                      memory.restart(e, theta, n, tick, resets);
                    });
    for (Readings& readings : line_) readings = line_[find_slot(0)];
  }

  // Measure if the machine has reached another tick.
  template <class Machine>
  void measure(const Machine& machine, std::int64_t tick) {
    if (tick == newest_) return;
    measure_at_tick(machine, tick, true,
                    [&](EncoderMemory& memory, const Encoder& e, double theta, const Noise& n) {
                      memory.measure(e, theta, n, tick);
                    });
  }

  const EncoderReading& encoder(int j) const {
    return line_[find_slot(structure.encoder[j].delay)].encoder[j];
  }
  const EncoderReading& link_encoder(int j) const {
    return line_[find_slot(structure.link_encoder[j].delay)].link_encoder[j];
  }
  // body(quantity, its readings by joint) for every kind of analog sensor.
  template <class Body>
  void for_each_analog(Body&& body) const {
    for_each_kind([&]<int k>(std::integral_constant<int, k>) {
      constexpr const auto& row = std::get<k>(structure.analog);
      body(typename std::tuple_element_t<k, Rows>::Quantity{},
           [&](int j) { return line_[find_slot(row.at[j].delay)].analog[k][j]; });
    });
  }
  const ImuReading& imu(int m) const { return line_[find_slot(structure.imu[m].delay)].imu[m]; }

  // number(x) for all that they remember, in a fixed order.
  template <class Number>
  void for_each_number(Number&& number) {
    number(newest_);
    for (int j = 0; j < N; ++j) {
      motor_disc_[j].for_each_number(number);
      link_disc_[j].for_each_number(number);
    }
    for (Readings& readings : line_) readings.for_each_number(number);
    for (auto& row : drifted_.analog)
      for (double& value : row) number(value);
    for (int k = 0; k < 6 * M; ++k) number(drifted_.imu[k]);
  }

 private:
  using Rows = decltype(structure.analog);
  template <class Body>
  static void for_each_kind(Body&& body) {
    [&]<int... k>(std::integer_sequence<int, k...>) {
      (body(std::integral_constant<int, k>{}), ...);
    }(std::make_integer_sequence<int, K>{});
  }

  static constexpr int kLength = structure.longest_delay() + 1;
  static constexpr int kChannels = 4;  // of a joint, two of them its encoders

  // Index of the readings of that many ticks ago.
  int find_slot(int ago) const {
    const std::int64_t tick = newest_ + kLength - ago;
    return static_cast<int>(tick % kLength);
  }

  template <class Machine, class Turn>
  __attribute__((noinline)) void measure_at_tick(const Machine& machine, std::int64_t tick,
                                                 bool has_past, Turn&& turn) {
    double values[S::parameters + 1] = {};
    for (int k = 0; k < S::parameters; ++k) values[k] = machine.parameter(k);
    auto suite = S::sensors(values);
    const auto noises = [&](int who) { return Noise::make_stream(suite.seed, who); };
    double current[N], angle[N], speed[N];
    machine.get_motor_signals(current, angle, speed);
    const SensorInput<Machine> input = {machine, current, angle, speed};
    const auto& x = machine.state();
    // Since the tick before, in which the machine has gone on.
    const double period = has_past ? machine.time() / static_cast<double>(tick) : 0.0;
    newest_ = tick;
    Readings& now = line_[find_slot(0)];
    const Readings& before = line_[find_slot(kLength > 1 ? 1 : 0)];
    for (int j = 0; j < N; ++j) {
      const int who = kChannels * j;
      turn(motor_disc_[j], suite.encoder[j], angle[j], noises(who));
      now.encoder[j] = motor_disc_[j].now;
      if (structure.link_encoder[j].kind != EncoderKind::none) {
        turn(link_disc_[j], suite.link_encoder[j], x.q[j], noises(who + 1));
        now.link_encoder[j] = link_disc_[j].now;
      }
    }
    for_each_kind([&]<int k>(std::integral_constant<int, k>) {
      constexpr const auto& row = std::get<k>(structure.analog);
      double truth[N];
      std::tuple_element_t<k, Rows>::Quantity::of(input, truth);
      for (int j = 0; j < N; ++j)
        if (row.has_reading(j)) {
          AnalogSensor& sensor = std::get<k>(suite.analog).at[j];
          add_drift(sensor, drifted_.analog[k][j], period);
          const Noise draws = noises(row.first + row.stride * j);
          now.analog[k][j] = has_past && repeats_reading(sensor.held, draws, tick)
                                 ? before.analog[k][j]
                                 : sensor.read(truth[j], draws, tick);
        }
    });
    if constexpr (M > 0) {
      double a[N];
      machine.compute_accelerations(a);
      LinkMotion motions[S::L];
      compute_link_motions(machine.numbers(), x.q, x.v, a, motions);
      for (int m = 0; m < M; ++m) {
        Imu& imu = suite.imu[m];
        for (int k = 0; k < 6; ++k)
          add_drift(k < 3 ? imu.accelerometer[k] : imu.gyroscope[k - 3], drifted_.imu[6 * m + k],
                    period);
        const LinkMotion& motion = motions[imu.link];
        const auto of_channel = [&](int k) { return noises(-2 - 6 * m - k); };
        const ImuReading previous = before.imu[m];
        now.imu[m] = imu.read(motion.force_at(imu.p), motion.omega, of_channel, tick);
        for (int k = 0; has_past && k < 3; ++k) {
          if (repeats_reading(imu.accelerometer[k].held, of_channel(k), tick))
            now.imu[m].specific_force[k] = previous.specific_force[k];
          if (repeats_reading(imu.gyroscope[k].held, of_channel(3 + k), tick))
            now.imu[m].angular_rate[k] = previous.angular_rate[k];
        }
      }
    }
  }

  static void add_drift(AnalogSensor& sensor, double& drifted, double period) {
    drifted += sensor.drift * period;
    sensor.offset += drifted;
  }
  struct Drifted {
    double analog[K][N] = {}, imu[6 * M + 1] = {};
  };

  std::int64_t newest_ = 0;  // tick of the newest readings
  Drifted drifted_;          // of analog sensors since the reset
  EncoderMemory motor_disc_[N], link_disc_[N];
  Readings line_[kLength];  // of the newest ticks, each at its tick modulo their number
};

}  // namespace arm
