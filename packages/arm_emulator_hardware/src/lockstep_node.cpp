// A controller manager on the machine's time, in the place of ros2_control_node.
//
// Parameters beside the manager's: real_time_factor, at which the machine's time goes at most; 0:
// as fast as the controllers compute. start: running, or paused, in which time stands until the
// service ~/pause is called with false. Controllers have their input from before that call in the
// first cycle after it, so the input acts at the same time on every run.

#include <atomic>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <exception>
#include <memory>
#include <sstream>
#include <thread>

#include "lockstep.hpp"
#include "std_srvs/srv/set_bool.hpp"

namespace {

using arm_emulator_hardware::Lockstep;
using controller_manager::ControllerManager;

// Why the parameters cannot be taken; empty: they can.
std::string describe_obstacle(double factor, const std::string& start) {
  if (!(factor == 0.0 || (factor >= 1e-6 && std::isfinite(factor)))) {
    std::ostringstream got;
    got << factor;
    return "real_time_factor must be 0, or at least 1e-06, got " + got.str();
  }
  if (start != "running" && start != "paused")
    return "start must be known, got " + start + "; valid: running, paused";
  return "";
}

// Go through cycles until ROS is shut down; false: something has gone wrong.
bool run_lockstep(Lockstep& lockstep, double factor, const std::atomic<bool>& paused) {
  auto next = std::chrono::steady_clock::now();
  for (bool stood = true; rclcpp::ok();) {
    if (paused || stood) {
      stood = paused;
      if (!lockstep.cycle(false)) break;  // one more once time goes on
      if (stood) rclcpp::sleep_for(std::chrono::milliseconds(1));
      next = std::chrono::steady_clock::now();
      continue;
    }
    if (!lockstep.cycle()) break;
    if (factor == 0.0) continue;
    next += std::chrono::nanoseconds(std::llround(lockstep.period().nanoseconds() / factor));
    std::this_thread::sleep_until(next);
  }
  return !rclcpp::ok();
}

int run(int argc, char** argv) {
  rclcpp::init(argc, argv);
  // A single thread: a callback of a controller ends before that of ~/pause begins.
  auto executor = std::make_shared<rclcpp::executors::SingleThreadedExecutor>();
  auto options = controller_manager::get_cm_node_options();
  std::vector<std::string> arguments(argv + 1, argv + argc);
  if (arguments.empty()) arguments = {"--ros-args"};
  arguments.insert(arguments.end(), {"-p", "use_sim_time:=true"});
  options.arguments(arguments);
  auto manager = std::make_shared<ControllerManager>(executor, "controller_manager", "", options);
  double factor = 1.0;
  std::string start = "running";
  manager->get_parameter("real_time_factor", factor);
  manager->get_parameter("start", start);
  const std::string why = describe_obstacle(factor, start);
  std::atomic<bool> paused = start == "paused";
  using Pause = std_srvs::srv::SetBool;
  const auto pause = manager->create_service<Pause>(
      "~/pause",
      [&](const Pause::Request::SharedPtr& request, const Pause::Response::SharedPtr& response) {
        paused = request->data;
        response->success = true;
      });
  bool sound = why.empty();
  if (!sound) {
    RCLCPP_ERROR(manager->get_logger(), "%s: %s", manager->get_name(), why.c_str());
  } else {
    executor->add_node(manager);
    std::atomic<bool> failed = false;
    std::thread spinner([&] {
      try {
        executor->spin();
      } catch (const std::exception& error) {  // a description that no component takes
        RCLCPP_ERROR(manager->get_logger(), "%s: %s", manager->get_name(), error.what());
        failed = true;
        rclcpp::shutdown();
      }
    });
    Lockstep lockstep(manager);
    while (rclcpp::ok() && !manager->is_resource_manager_initialized())
      rclcpp::sleep_for(std::chrono::milliseconds(10));
    sound = run_lockstep(lockstep, factor, paused);
    rclcpp::shutdown();  // ends the spinner even before it begins, which `cancel` does not
    spinner.join();
    sound = sound && !failed;
  }
  rclcpp::shutdown();
  return sound ? 0 : 2;
}

}  // namespace

int main(int argc, char** argv) {
  try {
    return run(argc, argv);
  } catch (const std::exception& error) {  // of ROS: a file of parameters that it does not take
    std::fprintf(stderr, "lockstep_node: %s\n", error.what());
    return 2;
  }
}
