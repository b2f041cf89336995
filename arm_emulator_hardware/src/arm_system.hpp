// An emulated arm as a hardware component of ros2_control: in process, and without a clock. Every
// write advances the machine by one period of the controllers, so a run repeats to the last bit.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "driven_machine.hpp"
#include "hardware_interface/system_interface.hpp"
#include "rclcpp/clock.hpp"

namespace arm_emulator_hardware {

class ArmSystem : public hardware_interface::SystemInterface {
 public:
  using CallbackReturn = hardware_interface::CallbackReturn;
  using State = rclcpp_lifecycle::State;

  CallbackReturn on_init(
      const hardware_interface::HardwareComponentInterfaceParams& params) override;
  CallbackReturn on_configure(const State& before) override;
  CallbackReturn on_cleanup(const State& before) override;
  CallbackReturn on_activate(const State& before) override;
  CallbackReturn on_deactivate(const State& before) override;
  CallbackReturn on_error(const State& before) override;

  hardware_interface::return_type prepare_command_mode_switch(
      const std::vector<std::string>& start, const std::vector<std::string>& stop) override;
  hardware_interface::return_type perform_command_mode_switch(
      const std::vector<std::string>& start, const std::vector<std::string>& stop) override;
  hardware_interface::return_type read(const rclcpp::Time& time,
                                       const rclcpp::Duration& period) override;
  hardware_interface::return_type write(const rclcpp::Time& time,
                                        const rclcpp::Duration& period) override;

 private:
  struct Command {
    int joint;
    Loop loop;
    hardware_interface::CommandInterface::SharedPtr value;
  };
  struct Reading {
    int joint;
    double JointReading::* quantity;
    hardware_interface::StateInterface::SharedPtr value;
  };

  // Log a refusal, one line.
  CallbackReturn refuse(const std::string& why) const;
  void refuse(const Command& one, double got);
  void check_interfaces() const;
  std::vector<double> start() const;
  void find_interfaces();
  const Command* command_of(const std::string& name) const;
  void publish();

  rclcpp::Clock steady_{RCL_STEADY_TIME};  // for the log alone
  std::unique_ptr<DrivenMachine> machine_;
  std::vector<Command> commands_;
  std::vector<Reading> readings_;
  hardware_interface::CommandInterface::SharedPtr power_;
  hardware_interface::StateInterface::SharedPtr powered_;
};

}  // namespace arm_emulator_hardware
