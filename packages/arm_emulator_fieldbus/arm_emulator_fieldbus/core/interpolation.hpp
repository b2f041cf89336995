// Cyclic positions: a line from target to target, over the interpolation time 0x60C2.
//
// Its speed, for the feed-forward, is smoothed, since differences of targets in whole counts jump
// by a count per period.
#pragma once

namespace fieldbus {

class Interpolation {
 public:
  // Hold a position.
  void begin(double position) {
    position_ = goal_ = position;
    speed_ = 0.0;
    left_ = 0;
  }
  // Take a target that is to be reached in so many periods. A target that comes again, as from a
  // master with data in every period, leaves the line as it is.
  void aim(double goal, int periods) {
    if (left_ > 0 && goal == goal_) return;
    goal_ = goal;
    left_ = periods;
  }
  void advance(double dt, double smoothing) {
    const double before = position_;
    if (left_ > 1)
      position_ += (goal_ - position_) / left_;
    else
      position_ = goal_;
    if (left_ > 0) --left_;
    speed_ += ((position_ - before) / dt - speed_) * (dt / (dt + smoothing));
  }
  double position() const { return position_; }
  double speed() const { return speed_; }

 private:
  double position_ = 0.0, goal_ = 0.0, speed_ = 0.0;
  int left_ = 0;
};

}  // namespace fieldbus
