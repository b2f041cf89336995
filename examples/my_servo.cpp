// A servo of one's own in place of ours, with rclcpp: 1 V for each radian that a motor is off its
// target. The same law as my_servo.py.

#include <arm_emulator_msgs/msg/motor_command.hpp>
#include <arm_emulator_msgs/msg/motor_state.hpp>
#include <cmath>
#include <map>
#include <memory>
#include <rclcpp/rclcpp.hpp>
#include <sensor_msgs/msg/joint_state.hpp>
#include <string>
#include <vector>

using arm_emulator_msgs::msg::MotorCommand;
using arm_emulator_msgs::msg::MotorState;
using sensor_msgs::msg::JointState;

namespace {

// rad of a joint per encoder count: gear 1/100, 1024 counts
constexpr double kCount = 0.01 * 2.0 * M_PI / 1024;
constexpr double kGain = 100.0;   // V/rad, at the joint
constexpr int kMotionTicks = 50;  // joint targets come once in so many servo periods

class MyServo : public rclcpp::Node {
 public:
  MyServo() : Node("my_servo") {
    commands_ = create_publisher<MotorCommand>("motor_commands", 1);
    joint_states_ = create_publisher<JointState>("joint_states", 5);
    states_ = create_subscription<MotorState>("motor_states", rclcpp::SensorDataQoS(),
                                              [this](const MotorState& state) { on_state(state); });
    targets_in_ = create_subscription<JointState>(
        "joint_targets", 1, [this](const JointState& targets) { on_targets(targets); });
  }

 private:
  // Answer at once, or at the start of a motion period with the targets for it.
  void on_state(const MotorState& state) {
    state_ = state;
    q_.clear();
    for (const auto count : state.encoder_counts)
      q_.push_back(kCount * (static_cast<double>(count) + 0.5));
    if (state.tick % kMotionTicks == 0) {
      JointState measured;
      measured.header = state.header;
      measured.name = state.joint_names;
      measured.position = q_;
      joint_states_->publish(measured);
    } else {
      answer();
    }
  }

  // Take new targets; those that answer the newest joint states end the wait.
  void on_targets(const JointState& targets) {
    for (std::size_t k = 0; k < targets.name.size(); ++k)
      targets_[targets.name[k]] = targets.position.at(k);
    if (targets.header.stamp == state_.header.stamp) answer();
  }

  // Publish the voltages for the servo period that began with the newest state.
  void answer() {
    MotorCommand answer;
    answer.header = state_.header;
    answer.tick = state_.tick;
    answer.joint_names = state_.joint_names;
    for (std::size_t j = 0; j < q_.size(); ++j) {
      const auto target = targets_.find(state_.joint_names[j]);
      answer.command.push_back(target == targets_.end() ? 0.0 : kGain * (target->second - q_[j]));
    }
    commands_->publish(answer);
  }

  MotorState state_;
  std::vector<double> q_;
  std::map<std::string, double> targets_;
  rclcpp::Publisher<MotorCommand>::SharedPtr commands_;
  rclcpp::Publisher<JointState>::SharedPtr joint_states_;
  rclcpp::Subscription<MotorState>::SharedPtr states_;
  rclcpp::Subscription<JointState>::SharedPtr targets_in_;
};

}  // namespace

int main(int argc, char** argv) {
  rclcpp::init(argc, argv);
  rclcpp::spin(std::make_shared<MyServo>());
  rclcpp::shutdown();
}
