// An emulated arm as a hardware component of ros2_control: in process, and without a clock. Every
// write of the active component advances the machine by one period of the controllers, so a run
// repeats to the last bit. Once it was active, the inactive one goes on without its drives.
#pragma once

#include <map>
#include <memory>
#include <string>
#include <vector>

#include "driven_machine.hpp"
#include "hardware_interface/system_interface.hpp"
#include "rclcpp/clock.hpp"
#include "rclcpp/time.hpp"

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

  struct Number {
    int which;  // of the machine's varied numbers
    hardware_interface::CommandInterface::SharedPtr value;
  };

  // Log a refusal, one line.
  CallbackReturn refuse(const std::string& why) const;
  void refuse(const hardware_interface::CommandInterface& one, double got,
              const std::string& bounds);
  hardware_interface::return_type refuse(Outcome outcome) const;
  void check_interfaces() const;
  std::vector<double> start() const;
  std::map<std::string, double> varied() const;
  void find_interfaces();
  void forget_interfaces();
  const Command* command_of(const std::string& name) const;
  void take_commands();
  void publish();

  rclcpp::Clock steady_{RCL_STEADY_TIME};  // for the log alone
  std::unique_ptr<DrivenMachine> machine_;
  std::vector<Command> commands_;
  std::vector<Reading> readings_;
  std::vector<Number> numbers_;
  hardware_interface::CommandInterface::SharedPtr power_;
  hardware_interface::StateInterface::SharedPtr powered_;
  bool begun_ = false;       // it was active since it was configured
  bool has_passed_ = false;  // this cycle's period, in `read`
  rclcpp::Time read_at_;
};

}  // namespace arm_emulator_hardware
