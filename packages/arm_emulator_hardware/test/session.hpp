// A controller manager with an emulated arm, cycle by cycle and without a clock.
#pragma once

#include <chrono>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <future>
#include <iterator>
#include <memory>
#include <stdexcept>
#include <string>
#include <vector>

#include "controller_manager/controller_manager.hpp"
#include "controller_manager_msgs/srv/switch_controller.hpp"
#include "lockstep.hpp"
#include "rclcpp/rclcpp.hpp"

// The number that a word is; throws for other words.
inline double number(const char* word) {
  char* end = nullptr;
  const double value = std::strtod(word, &end);
  if (end == word || *end) throw std::invalid_argument(word);
  return value;
}

// Run a program, whose exceptions end it with a line and 70; at once, since a manager that throws
// while it is made leaves a callback behind.
template <class Program>
int sheltered(Program program) {
  try {
    return program();
  } catch (const std::exception& error) {
    std::fprintf(stderr, "%s\n", error.what());
    std::quick_exit(70);
  }
}

// FNV-1a over the bits of numbers.
struct Digest {
  std::uint64_t value = 14695981039346656037u;
  void add(double number) {
    std::uint64_t bits;
    std::memcpy(&bits, &number, sizeof bits);
    for (int k = 0; k < 8; ++k) value = (value ^ (bits >> 8 * k & 255)) * 1099511628211u;
  }
};

struct Manager : controller_manager::ControllerManager {
  using ControllerManager::ControllerManager;
  double state(const std::string& name) {
    return resource_manager_->claim_state_interface(name).get_optional<double>().value_or(NAN);
  }
  // Label of the lifecycle state of a hardware component.
  std::string component(const std::string& name) const {
    return resource_manager_->get_components_status().at(name).state.label();
  }
  bool activate(const std::string& name) {
    rclcpp_lifecycle::State active(lifecycle_msgs::msg::State::PRIMARY_STATE_ACTIVE, "active");
    return resource_manager_->set_component_state(name, active) ==
           hardware_interface::return_type::OK;
  }
};

class Session {
  static constexpr int kRounds = 3;  // the first one may only find new readers
  static constexpr int kOthers = 5;  // exit code: another process publishes /clock

 public:
  Session(const char* description, const char* parameters)
      : executor_(std::make_shared<rclcpp::executors::SingleThreadedExecutor>()),
        manager(make_manager(description, parameters)),
        lockstep(manager),
        node_(std::make_shared<rclcpp::Node>("commander")) {
    executor_->add_node(manager);
    executor_->add_node(node_);
  }
  ~Session() {
    executor_->remove_node(node_);
    executor_->remove_node(manager);
  }
  Session(const Session&) = delete;
  Session& operator=(const Session&) = delete;

  bool load(const std::string& controller) {
    return manager->load_controller(controller) &&
           manager->configure_controller(controller) == controller_interface::return_type::OK;
  }

  // The machine stands meanwhile.
  static constexpr double kSwitch = 120.0;  // s, wall: for what takes some ms on an idle machine
  bool change(const std::vector<std::string>& start, const std::vector<std::string>& stop) {
    using Request = controller_manager_msgs::srv::SwitchController::Request;
    auto done = std::async(std::launch::async, [&] {
      return manager->switch_controller(start, stop, Request::STRICT, true,
                                        rclcpp::Duration::from_seconds(kSwitch));
    });
    while (done.wait_for(std::chrono::milliseconds(1)) != std::future_status::ready)
      if (!lockstep.cycle(false)) std::quick_exit(kOthers);  // the switch would wait for a cycle
    return done.get() == controller_interface::return_type::OK;
  }

  // Publish a message; whoever listens has taken it when this returns. False: nobody did.
  template <class Message>
  bool send(const std::string& topic, const Message& message) {
    const auto publisher = node_->create_publisher<Message>(topic, 10);
    bool heard = false;
    const auto listener =
        node_->create_subscription<Message>(topic, 10, [&](const Message&) { heard = true; });
    const auto wait = [&](auto until) {
      while (rclcpp::ok() && !until()) executor_->spin_once(std::chrono::milliseconds(1));
    };
    wait([&] { return publisher->get_subscription_count() > 1; });
    publisher->publish(message);
    if (!publisher->wait_for_all_acked(std::chrono::seconds(30))) return false;
    wait([&] { return heard; });
    // Every reader has it by now: the executor finds them all.
    for (int more = 0; more < kRounds; ++more) executor_->spin_some();
    return heard;
  }

 private:
  std::shared_ptr<rclcpp::executors::SingleThreadedExecutor> executor_;

  std::shared_ptr<Manager> make_manager(const char* description, const char* parameters) {
    std::ifstream stream(description);
    const std::string text{std::istreambuf_iterator<char>(stream), {}};
    // The manager passes its arguments on to its controllers.
    auto options = controller_manager::get_cm_node_options();
    options.arguments({"--ros-args", "--params-file", parameters, "-p", "use_sim_time:=true"});
    return std::make_shared<Manager>(executor_, text, true, "controller_manager", "", options);
  }

 public:
  const std::shared_ptr<Manager> manager;
  arm_emulator_hardware::Lockstep lockstep;

 private:
  std::shared_ptr<rclcpp::Node> node_;
};
