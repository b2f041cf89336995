// Cycles of a controller manager on the machine's time: /clock is published for every cycle, which
// begins when the manager has it. No wall clock takes part, and no time of another process.
#pragma once

#include <memory>

#include "controller_manager/controller_manager.hpp"
#include "rclcpp/rclcpp.hpp"
#include "rosgraph_msgs/msg/clock.hpp"

namespace arm_emulator_hardware {

class Lockstep {
 public:
  // Of a manager with use_sim_time.
  explicit Lockstep(std::shared_ptr<controller_manager::ControllerManager> manager)
      : manager_(std::move(manager)),
        period_(rclcpp::Duration::from_nanoseconds(1'000'000'000 / manager_->get_update_rate())),
        publisher_(manager_->create_publisher<rosgraph_msgs::msg::Clock>(
            kClock, rclcpp::ClockQoS().keep_last(10).reliable())),
        now_(0, 0, manager_->get_clock()->get_clock_type()) {}

  rclcpp::Time now() const { return now_; }
  rclcpp::Duration period() const { return period_; }

  // Go through one cycle; without `advance` the machine stands, as it does while controllers are
  // switched. False, after a line in the log, if another process publishes /clock, too: its times
  // would go into the controllers; the machine has not advanced. False if ROS was shut down.
  bool cycle(bool advance = true) {
    if (advance || now_.nanoseconds() == 0) now_ += period_;
    if (!set_time()) return false;
    manager_->read(now_, period_);
    manager_->update(now_, period_);
    if (manager_->now() != now_) return refuse_second_node();
    if (advance) manager_->write(now_, period_);
    return true;
  }

 private:
  bool set_time() {
    rosgraph_msgs::msg::Clock message;
    message.clock = now_;
    for (int tries = 0; manager_->now() != now_; ++tries) {
      if (!rclcpp::ok()) return false;
      if (tries % kPatience == 0) {  // nobody may have listened yet
        if (tries > 0 && manager_->count_publishers(kClock) > 1) return refuse_second_node();
        publisher_->publish(message);
      }
      rclcpp::sleep_for(std::chrono::microseconds(20));
    }
    return true;
  }

  bool refuse_second_node() const {
    if (!rclcpp::ok()) return false;
    RCLCPP_ERROR(manager_->get_logger(),
                 "%s: %s must be published by this process alone, got a time of another; valid: a "
                 "ROS_DOMAIN_ID of its own",
                 manager_->get_name(), kClock);
    return false;
  }

  static constexpr int kPatience = 5000;
  static constexpr const char* kClock = "/clock";
  std::shared_ptr<controller_manager::ControllerManager> manager_;
  rclcpp::Duration period_;
  rclcpp::Publisher<rosgraph_msgs::msg::Clock>::SharedPtr publisher_;
  rclcpp::Time now_;
};

}  // namespace arm_emulator_hardware
