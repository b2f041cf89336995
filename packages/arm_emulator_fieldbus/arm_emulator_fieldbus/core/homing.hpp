// Homing methods.
//
//   0       none: a start fails
//   35, 37  here                       -3, -4  the stop ahead (-3) or behind (-4)
//   33, 34  the next index pulse,      -1, -2  the same, then the first index pulse on the way back
//           backwards or forwards
//
// A stop is met when the torque has reached its limit 0x2003 and the motor stands.
#pragma once

#include <cmath>
#include <cstdint>

namespace fieldbus {

class Homing {
 public:
  static constexpr int kMethods = 8;
  static constexpr int method[kMethods] = {35, 37, 33, 34, -1, -2, -3, -4};
  static bool known(std::int64_t one, bool index, bool stops) {
    const bool here = one == 35 || one == 37, by_index = one == 33 || one == 34;
    return one == 0 || here || (by_index && index) ||
           (one < 0 && one >= -4 && stops && (one < -2 || index));
  }
  static bool is_by_stop(std::int64_t one) { return one < 0; }

  enum class Phase { idle, to_stop, to_index, slowing, attained, failed };
  Phase phase() const { return phase_; }
  bool moves() const {
    return phase_ == Phase::to_stop || phase_ == Phase::to_index || phase_ == Phase::slowing;
  }

  void start(int one, std::int64_t position, std::int64_t pulses) {
    method_ = one;
    began_ = position;
    pulses_ = pulses;
    pressed_ = 0.0;
    if (one == 0)
      phase_ = Phase::failed;
    else if (one == 35 || one == 37)
      finish_homing(position);
    else
      phase_ = one < 0 ? Phase::to_stop : Phase::to_index;
  }
  void interrupt() {
    if (moves()) phase_ = Phase::idle;
  }

  // Direction: -1, 0 or 1.
  int direction() const {
    const int forward = method_ == 34 || method_ == -1 || method_ == -3 ? 1 : -1;
    if (phase_ == Phase::to_stop) return forward;
    if (phase_ == Phase::to_index) return method_ < 0 ? -forward : forward;
    return 0;
  }

  // Evaluate a period. `pressing`: the torque is at its limit and the motor stands.
  void look(std::int64_t position, std::int64_t pulses, std::int64_t index, bool pressing,
            double speed, std::int64_t counts_per_turn, double dt) {
    const std::int64_t distance = position > began_ ? position - began_ : began_ - position;
    if (phase_ == Phase::to_stop) {
      pressed_ = pressing ? pressed_ + dt : 0.0;
      if (pressed_ >= kPressed) {
        if (method_ >= -2) {
          phase_ = Phase::to_index;
          began_ = position;
          pulses_ = pulses;
        } else {
          home_ = position;
          phase_ = Phase::slowing;
        }
      } else if (distance > kFarthest) {
        phase_ = Phase::failed;
      }
    } else if (phase_ == Phase::to_index) {
      if (pulses != pulses_) {
        home_ = index;
        phase_ = Phase::slowing;
      } else if (distance > kRevolutions * counts_per_turn) {
        phase_ = Phase::failed;
      }
    } else if (phase_ == Phase::slowing && speed == 0.0) {
      phase_ = Phase::attained;
      new_home_ = true;
    }
  }
  // Whether a home was found since the last call.
  bool take(std::int64_t& home) {
    if (!new_home_) return false;
    new_home_ = false;
    home = home_;
    return true;
  }

 private:
  static constexpr double kPressed = 0.05;  // s
  static constexpr std::int64_t kRevolutions = 3;
  static constexpr std::int64_t kFarthest = std::int64_t{1} << 31;

  void finish_homing(std::int64_t position) {
    home_ = position;
    new_home_ = true;
    phase_ = Phase::attained;
  }

  Phase phase_ = Phase::idle;
  int method_ = 0;
  bool new_home_ = false;
  std::int64_t began_ = 0, pulses_ = 0, home_ = 0;
  double pressed_ = 0.0;  // s
};

}  // namespace fieldbus
