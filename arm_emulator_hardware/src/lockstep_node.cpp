// A controller manager on the machine's time, in the place of ros2_control_node.
//
// Parameters beside the manager's: real_time_factor, at which the machine's time goes at most; 0:
// as fast as the controllers compute.

#include <chrono>
#include <cmath>
#include <memory>
#include <thread>

#include "lockstep.hpp"

int main(int argc, char** argv) {
  rclcpp::init(argc, argv);
  auto executor = std::make_shared<rclcpp::executors::MultiThreadedExecutor>();
  auto options = controller_manager::get_cm_node_options();
  std::vector<std::string> arguments(argv + 1, argv + argc);
  if (arguments.empty()) arguments = {"--ros-args"};
  arguments.insert(arguments.end(), {"-p", "use_sim_time:=true"});
  options.arguments(arguments);
  auto manager = std::make_shared<controller_manager::ControllerManager>(
      executor, "controller_manager", "", options);
  executor->add_node(manager);
  std::thread spinner([&] { executor->spin(); });

  double factor = 1.0;
  manager->get_parameter("real_time_factor", factor);
  const bool sound = factor >= 0.0 && std::isfinite(factor);
  if (!sound) {
    RCLCPP_ERROR(manager->get_logger(),
                 "controller_manager: real_time_factor must be at least 0, got %g", factor);
  } else {
    arm_emulator_hardware::Lockstep lockstep(manager);
    while (rclcpp::ok() && !manager->is_resource_manager_initialized())
      rclcpp::sleep_for(std::chrono::milliseconds(10));
    auto next = std::chrono::steady_clock::now();
    while (rclcpp::ok() && lockstep.cycle()) {
      if (factor == 0.0) continue;
      next += std::chrono::nanoseconds(std::llround(lockstep.period().nanoseconds() / factor));
      std::this_thread::sleep_until(next);
    }
  }
  executor->cancel();
  spinner.join();
  rclcpp::shutdown();
  return sound ? 0 : 2;
}
