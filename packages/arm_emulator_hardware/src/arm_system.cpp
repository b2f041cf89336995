#include "arm_system.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdlib>
#include <limits>
#include <utility>

#include "pluginlib/class_list_macros.hpp"
#include "rclcpp/logging.hpp"

namespace arm_emulator_hardware {
namespace {

using hardware_interface::return_type;

constexpr double kUnset = std::numeric_limits<double>::quiet_NaN();

constexpr std::array<std::pair<const char*, Loop>, 3> kCommands = {
    {{"position", Loop::position}, {"velocity", Loop::velocity}, {"effort", Loop::effort}}};

constexpr std::array<std::pair<const char*, double JointReading::*>, 9> kReadings = {
    {{"position", &JointReading::position},
     {"velocity", &JointReading::velocity},
     {"effort", &JointReading::effort},
     {"current", &JointReading::current},
     {"temperature", &JointReading::temperature},
     {"motor_counts", &JointReading::motor_counts},
     {"true_position", &JointReading::true_position},
     {"true_velocity", &JointReading::true_velocity},
     {"true_effort", &JointReading::true_effort}}};

// The entry of that name; null if no entry has it.
template <class Table>
const typename Table::value_type* entry(const Table& table, const std::string& name) {
  const auto found =
      std::find_if(table.begin(), table.end(), [&](const auto& one) { return name == one.first; });
  return found == table.end() ? nullptr : &*found;
}

template <class Table>
std::string names(const Table& table) {
  std::string all;
  for (const auto& one : table) all += (all.empty() ? "" : ", ") + std::string(one.first);
  return all;
}

// Throw unless the table has the name.
template <class Table>
void check_name(const std::string& where, const std::string& what, const std::string& name,
                const Table& table) {
  if (entry(table, name)) return;
  std::string why = where;
  why.append(": ").append(what).append(" must be known, got ").append(name);
  throw Refused(why.append("; valid: ").append(names(table)));
}

template <class Table>
void check_names(const std::string& where, const std::string& what,
                 const std::vector<hardware_interface::InterfaceInfo>& given, const Table& table) {
  for (const auto& one : given) check_name(where, what, one.name, table);
}

// Throw unless all are numbers.
void check_types(const std::string& where,
                 const std::vector<hardware_interface::InterfaceInfo>& given) {
  for (const auto& one : given)
    if (!one.data_type.empty() && one.data_type != "double")
      throw Refused(where + ": data_type of " + one.name + " must be double, got " + one.data_type);
}

constexpr const char* kPower = "power";
constexpr std::array<std::pair<const char*, int>, 1> kPowered = {{{"powered", 0}}};
constexpr std::array<std::pair<const char*, int>, 1> kParameters = {{{"scene", 0}}};

// The initial value in a description. Throws Refused.
double number_of(const std::string& where, const hardware_interface::InterfaceInfo& one) {
  char* end = nullptr;
  const double value = std::strtod(one.initial_value.c_str(), &end);
  if (*end || !std::isfinite(value))
    throw Refused(where + ": initial_value of " + one.name + " must be a number, got " +
                  one.initial_value);
  return value;
}

double value_of(const hardware_interface::CommandInterface::SharedPtr& one) {
  return one->get_optional<double>().value_or(kUnset);
}

}  // namespace

ArmSystem::CallbackReturn ArmSystem::refuse(const std::string& why) const {
  RCLCPP_ERROR(get_logger(), "%s", why.c_str());
  return CallbackReturn::ERROR;
}

// The newest sound command holds; a controller may repeat the other one each cycle.
void ArmSystem::refuse(const hardware_interface::CommandInterface& one, double got,
                       const std::string& bounds) {
  RCLCPP_ERROR_THROTTLE(get_logger(), steady_, 1000,
                        "%s: %s must be within %s, got %g; its command before holds",
                        info_.name.c_str(), one.get_name().c_str(), bounds.c_str(), got);
}

ArmSystem::CallbackReturn ArmSystem::on_init(
    const hardware_interface::HardwareComponentInterfaceParams& params) {
  if (SystemInterface::on_init(params) != CallbackReturn::SUCCESS) return CallbackReturn::ERROR;
  try {
    check_interfaces();
  } catch (const Refused& why) {
    return refuse(why.what());
  }
  return CallbackReturn::SUCCESS;
}

void ArmSystem::check_interfaces() const {
  const std::string& where = info_.name;
  for (const auto& [name, value] : info_.hardware_parameters)
    check_name(where, "param", name, kParameters);
  if (!info_.hardware_parameters.count("scene"))
    throw Refused(where + ": scene must be given, FOLDER/NAME of a compiled scene, got nothing");
  if (info_.is_async)
    throw Refused(where + ": is_async must be false, or runs would not repeat, got true");
  for (const auto& joint : info_.joints) {
    const std::string at = where + ": " + joint.name;
    check_names(at, "command_interface", joint.command_interfaces, kCommands);
    check_names(at, "state_interface", joint.state_interfaces, kReadings);
    check_types(at, joint.command_interfaces);
    check_types(at, joint.state_interfaces);
  }
  for (const auto& gpio : info_.gpios) {
    const std::string at = where + ": " + gpio.name;
    check_names(at, "state_interface", gpio.state_interfaces, kPowered);
    check_types(at, gpio.command_interfaces);
    check_types(at, gpio.state_interfaces);
  }
}

// The joints' positions at the start: `initial_value` of their positions, or 0.
std::vector<double> ArmSystem::start() const {
  std::vector<double> q(static_cast<std::size_t>(machine_->joints()), 0.0);
  for (const auto& joint : info_.joints)
    for (const auto& one : joint.state_interfaces) {
      if (one.name != "position" || one.initial_value.empty()) continue;
      q[static_cast<std::size_t>(machine_->joint(joint.name))] =
          number_of(info_.name + ": " + joint.name, one);
    }
  return q;
}

// Varied numbers at the start: `initial_value` of their commands.
std::map<std::string, double> ArmSystem::varied() const {
  std::map<std::string, double> all;
  for (const auto& gpio : info_.gpios)
    for (const auto& one : gpio.command_interfaces)
      if (one.name != kPower && !one.initial_value.empty())
        all[one.name] = number_of(info_.name + ": " + gpio.name, one);
  return all;
}

void ArmSystem::forget_interfaces() {
  commands_.clear();
  readings_.clear();
  numbers_.clear();
  power_.reset();
  powered_.reset();
}

void ArmSystem::find_interfaces() {
  forget_interfaces();
  for (const auto& joint : info_.joints) {
    const int j = machine_->joint(joint.name);
    for (const auto& one : joint.command_interfaces)
      commands_.push_back({j, entry(kCommands, one.name)->second,
                           get_command_interface_handle(joint.name + "/" + one.name)});
    for (const auto& one : joint.state_interfaces)
      readings_.push_back({j, entry(kReadings, one.name)->second,
                           get_state_interface_handle(joint.name + "/" + one.name)});
  }
  for (const auto& gpio : info_.gpios) {
    for (const auto& one : gpio.command_interfaces) {
      const auto handle = get_command_interface_handle(gpio.name + "/" + one.name);
      if (one.name == kPower)
        power_ = handle;
      else
        numbers_.push_back({machine_->varied(one.name), handle});
    }
    for (const auto& one : gpio.state_interfaces)
      powered_ = get_state_interface_handle(gpio.name + "/" + one.name);
  }
}

ArmSystem::CallbackReturn ArmSystem::on_configure(const State&) {
  try {
    const std::int64_t period = 1'000'000'000 / std::max(1u, info_.rw_rate);
    if (info_.rw_rate == 0 || period * info_.rw_rate != 1'000'000'000)
      throw Refused(info_.name + ": update_rate must give whole ns, got " +
                    std::to_string(info_.rw_rate) + " Hz");
    machine_ =
        std::make_unique<DrivenMachine>(info_.hardware_parameters.at("scene"), period, varied());
    machine_->reset(start());
    find_interfaces();
  } catch (const Refused& why) {
    machine_.reset();
    return refuse(why.what());
  }
  begun_ = has_passed_ = false;
  publish();
  return CallbackReturn::SUCCESS;
}

ArmSystem::CallbackReturn ArmSystem::on_cleanup(const State&) {
  forget_interfaces();
  machine_.reset();
  return CallbackReturn::SUCCESS;
}

ArmSystem::CallbackReturn ArmSystem::on_activate(const State&) {
  for (const Command& one : commands_) (void)one.value->set_value(kUnset);
  for (const Number& one : numbers_) (void)one.value->set_value(kUnset);
  if (power_) (void)power_->set_value(kUnset);
  machine_->power(true);
  machine_->enable(true);
  begun_ = true;
  return CallbackReturn::SUCCESS;
}

ArmSystem::CallbackReturn ArmSystem::on_deactivate(const State&) {
  machine_->enable(false);
  return CallbackReturn::SUCCESS;
}

// The machine is put back to its start when it is configured again.
ArmSystem::CallbackReturn ArmSystem::on_error(const State& before) { return on_cleanup(before); }

const ArmSystem::Command* ArmSystem::command_of(const std::string& name) const {
  const auto found = std::find_if(commands_.begin(), commands_.end(), [&](const Command& one) {
    return one.value->get_name() == name;
  });
  return found == commands_.end() ? nullptr : &*found;
}

return_type ArmSystem::prepare_command_mode_switch(const std::vector<std::string>& start,
                                                   const std::vector<std::string>&) {
  std::vector<int> joints;
  for (const std::string& name : start) {
    const Command* one = command_of(name);
    if (!one) continue;  // of another component
    if (std::count(joints.begin(), joints.end(), one->joint)) {
      refuse(info_.name + ": " + one->value->get_prefix_name() +
             ": command_interface must be one at a time, got " + name + " beside another");
      return return_type::ERROR;
    }
    joints.push_back(one->joint);
  }
  return return_type::OK;
}

return_type ArmSystem::perform_command_mode_switch(const std::vector<std::string>& start,
                                                   const std::vector<std::string>& stop) {
  for (const std::string& name : stop)
    if (const Command* one = command_of(name)) machine_->select(one->joint, Loop::none);
  for (const std::string& name : start)
    if (const Command* one = command_of(name)) {
      (void)one->value->set_value(kUnset);  // until the controller commands
      machine_->select(one->joint, one->loop);
    }
  return return_type::OK;
}

void ArmSystem::publish() {
  for (const Reading& one : readings_)
    (void)one.value->set_value(machine_->reading(one.joint).*one.quantity, true);
  if (powered_) (void)powered_->set_value(machine_->powered() ? 1.0 : 0.0, true);
}

return_type ArmSystem::read(const rclcpp::Time& time, const rclcpp::Duration&) {
  const bool goes_on = read_at_.get_clock_type() == time.get_clock_type() && time > read_at_;
  read_at_ = time;
  has_passed_ = begun_ && goes_on && !machine_->enabled();
  if (has_passed_ && machine_->advance() == Outcome::diverged) return refuse(Outcome::diverged);
  publish();
  return return_type::OK;
}

void ArmSystem::take_commands() {
  if (power_)
    if (const double wanted = value_of(power_); std::isfinite(wanted))
      machine_->power(wanted != 0.0);
  for (const Number& one : numbers_)
    if (const double wanted = value_of(one.value); !std::isnan(wanted) &&
                                                   wanted != machine_->vary(one.which) &&
                                                   !machine_->vary(one.which, wanted))
      refuse(*one.value, wanted, machine_->bounds(one.which));
  for (const Command& one : commands_) {
    if (machine_->selected(one.joint) != one.loop) continue;
    const double wanted = value_of(one.value);
    if (!std::isnan(wanted) && !machine_->command(one.joint, wanted))
      refuse(*one.value, wanted, within(-DrivenMachine::kLargest, DrivenMachine::kLargest));
  }
}

return_type ArmSystem::write(const rclcpp::Time&, const rclcpp::Duration&) {
  take_commands();
  if (has_passed_) return return_type::OK;  // it became active in this cycle
  return refuse(machine_->advance());
}

return_type ArmSystem::refuse(Outcome outcome) const {
  switch (outcome) {
    case Outcome::advanced:
      return return_type::OK;
    case Outcome::no_power:
      refuse(info_.name + ": power must be on while drives are active, got a cut; deactivated");
      return return_type::DEACTIVATE;
    case Outcome::hot:
      refuse(info_.name + ": windings must stay below their limit, got one too hot; deactivated");
      return return_type::DEACTIVATE;
    case Outcome::refused:
      refuse(info_.name + ": commands must be those of the machine's drives, got others");
      return return_type::ERROR;
    case Outcome::diverged:
      refuse(info_.name + ": motion must stay within bounds, got a divergence");
      return return_type::ERROR;
  }
  return return_type::ERROR;
}

}  // namespace arm_emulator_hardware

PLUGINLIB_EXPORT_CLASS(arm_emulator_hardware::ArmSystem, hardware_interface::SystemInterface)
