// A joint_trajectory_controller moves an emulated arm, cycle by cycle and without a clock.
//
//   trajectory DESCRIPTION CONTROLLERS SECONDS JOINT=TARGET...
//
// prints a digest of the joints' states in every cycle, then for each joint its true position at
// the end, the measured one, and the true one at the start.

#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <future>
#include <iterator>
#include <string>
#include <vector>

#include "controller_manager/controller_manager.hpp"
#include "controller_manager_msgs/srv/switch_controller.hpp"
#include "lockstep.hpp"
#include "rclcpp/rclcpp.hpp"
#include "trajectory_msgs/msg/joint_trajectory.hpp"

namespace {

const char* const kController = "joint_trajectory_controller";
const double kRest = 0.5;  // s after the trajectory

std::string text_of(const char* file) {
  std::ifstream stream(file);
  return {std::istreambuf_iterator<char>(stream), {}};
}

struct Manager : controller_manager::ControllerManager {
  using ControllerManager::ControllerManager;
  double state(const std::string& name) {
    return resource_manager_->claim_state_interface(name).get_optional<double>().value_or(NAN);
  }
};

// FNV-1a over the bits of numbers.
struct Digest {
  std::uint64_t value = 14695981039346656037u;
  void add(double number) {
    std::uint64_t bits;
    std::memcpy(&bits, &number, sizeof bits);
    for (int k = 0; k < 8; ++k) value = (value ^ (bits >> 8 * k & 255)) * 1099511628211u;
  }
};

}  // namespace

int main(int argc, char** argv) {
  if (argc < 5) return 64;
  const double seconds = std::atof(argv[3]);
  std::vector<std::string> joints;
  std::vector<double> target;
  for (int k = 4; k < argc; ++k) {
    const std::string word = argv[k];
    joints.push_back(word.substr(0, word.find('=')));
    target.push_back(std::atof(word.c_str() + word.find('=') + 1));
  }
  const char* words[] = {argv[0], "--ros-args", "--log-level", "warn"};
  rclcpp::init(4, words);
  auto executor = std::make_shared<rclcpp::executors::SingleThreadedExecutor>();
  // The manager passes its arguments on to its controllers.
  auto options = controller_manager::get_cm_node_options();
  options.arguments({"--ros-args", "--params-file", argv[2], "-p", "use_sim_time:=true"});
  auto manager = std::make_shared<Manager>(executor, text_of(argv[1]), true, "controller_manager",
                                           "", options);
  executor->add_node(manager);
  arm_emulator_hardware::Lockstep lockstep(manager);

  if (!manager->load_controller(kController) ||
      manager->configure_controller(kController) != controller_interface::return_type::OK)
    return 2;
  using Switch = controller_manager_msgs::srv::SwitchController::Request;
  auto switched = std::async(std::launch::async, [&] {
    return manager->switch_controller({kController}, {}, Switch::STRICT, true);
  });
  while (switched.wait_for(std::chrono::milliseconds(1)) != std::future_status::ready)
    lockstep.cycle(false);
  if (switched.get() != controller_interface::return_type::OK) return 3;

  auto node = std::make_shared<rclcpp::Node>("commander");
  executor->add_node(node);
  using Trajectory = trajectory_msgs::msg::JointTrajectory;
  const std::string topic = std::string("/") + kController + "/joint_trajectory";
  auto publisher = node->create_publisher<Trajectory>(topic, 10);
  int heard = 0;
  auto listener =
      node->create_subscription<Trajectory>(topic, 10, [&](const Trajectory&) { ++heard; });
  while (publisher->get_subscription_count() < 2) executor->spin_some();
  Trajectory motion;
  motion.joint_names = joints;
  motion.points.resize(1);
  motion.points[0].positions = target;
  motion.points[0].velocities.assign(target.size(), 0.0);
  motion.points[0].time_from_start = rclcpp::Duration::from_seconds(seconds);
  publisher->publish(motion);
  // The controller hears it, too, before the machine goes on.
  for (int more = 0; more < 50; more += heard > 0) {
    executor->spin_some();
    rclcpp::sleep_for(std::chrono::milliseconds(1));
  }

  Digest digest;
  std::vector<double> start;
  for (const auto& joint : joints) start.push_back(manager->state(joint + "/true_position"));
  const double periods = (seconds + kRest) / lockstep.period().seconds();
  for (long cycle = 0; cycle < std::lround(periods); ++cycle) {
    lockstep.cycle();
    for (std::size_t j = 0; j < joints.size(); ++j)
      for (const char* what : {"/position", "/velocity", "/effort", "/true_position"})
        digest.add(manager->state(joints[j] + what));
  }
  lockstep.cycle(false);
  std::printf("digest %016llx\n", static_cast<unsigned long long>(digest.value));
  for (std::size_t j = 0; j < joints.size(); ++j)
    std::printf("%s %.9f %.9f %.9f\n", joints[j].c_str(),
                manager->state(joints[j] + "/true_position"),
                manager->state(joints[j] + "/position"), start[j]);
  executor->remove_node(node);
  executor->remove_node(manager);
  manager.reset();
  rclcpp::shutdown();
  return 0;
}
