#include "driven_machine.hpp"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <limits>
#include <sstream>

#include "tick.c"

namespace arm_emulator_hardware {
namespace {

constexpr double kUnknown = std::numeric_limits<double>::quiet_NaN();

std::size_t at(int j) { return static_cast<std::size_t>(j); }

// The file FOLDER/NAME-DIGITS.so.
std::string library_file(const std::string& scene, const std::string& part) {
  namespace fs = std::filesystem;
  const fs::path path(scene);
  const std::string start = path.filename().string() + part + "-", end = ".so";
  std::error_code error;
  std::string found;
  for (fs::directory_iterator file(path.parent_path(), error), last; !error && file != last;
       file.increment(error)) {
    const std::string name = file->path().filename().string();
    if (name.size() <= start.size() + end.size() || name.compare(0, start.size(), start) != 0 ||
        name.compare(name.size() - end.size(), end.size(), end) != 0)
      continue;
    const std::string digits = name.substr(start.size(), name.size() - start.size() - end.size());
    if (digits.find_first_not_of("0123456789abcdef") != std::string::npos) continue;
    if (!found.empty()) {
      std::string why = scene + ": scene must be compiled once in its folder, got two of ";
      why.append(start).append("*.so; valid: `arm_emulator compile --into` an empty folder");
      throw Refused(why);
    }
    found = file->path().string();
  }
  if (found.empty())
    throw Refused(scene + ": scene must be FOLDER/NAME after `arm_emulator compile NAME --servo " +
                  "--into FOLDER`, got no " + start + "*.so there");
  return found;
}

}  // namespace

std::string within(double least, double most) {
  std::ostringstream text;
  text << least << " to " << most;
  return text.str();
}

DrivenMachine::DrivenMachine(const std::string& scene, std::int64_t period,
                             const std::map<std::string, double>& varied)
    : machine_library_(library_file(scene, "")), servo_library_(library_file(scene, "-servo")) {
  const std::string why = machine_library_.why() + servo_library_.why();
  if (!why.empty()) throw Refused(scene + ": scene must be loadable, got " + why);
  int (*describe)(arm_description*) = nullptr;
  int (*describe_joint)(std::int32_t, arm_joint_description*) = nullptr;
  int (*describe_parameter)(std::int32_t, arm_parameter*) = nullptr;
  arm_machine* (*make)(const arm_options*) = nullptr;
  decltype(&servo_get_data) get_data = nullptr;
  const bool whole =
      machine_library_.find("arm_describe", describe) && machine_library_.find("arm_new", make) &&
      machine_library_.find("arm_describe_joint", describe_joint) &&
      machine_library_.find("arm_describe_parameter", describe_parameter) &&
      machine_library_.find("arm_get_parameter", get_parameter_) &&
      machine_library_.find("arm_set_parameter", set_parameter_) &&
      machine_library_.find("arm_delete", delete_) &&
      machine_library_.find("arm_exchange", at_.exchange) &&
      machine_library_.find("arm_measure", at_.measure) &&
      machine_library_.find("arm_reset", reset_) && machine_library_.find("arm_power", power_) &&
      machine_library_.find("arm_get_truth", at_.get_truth) &&
      machine_library_.find("arm_get_winding_temperatures", temperatures_) &&
      servo_library_.find("servo_get_data", get_data) &&
      servo_library_.find("servo_reset", servo_reset_) &&
      servo_library_.find("servo_observe", servo_observe_) &&
      servo_library_.find("servo_drive", servo_drive_) &&
      servo_library_.find("servo_release", servo_release_) &&
      servo_library_.find("servo_wish_within", wish_within_);
  if (!whole) throw Refused(scene + ": scene must be of this version, got another library");

  arm_description about = {};
  about.size = sizeof about;
  data_.size = sizeof data_;
  describe(&about);
  get_data(&data_);
  servo_period_ = data_.period;
  if (about.version != ARM_VERSION || about.servo_period <= 0.0)
    throw Refused(scene + ": scene must be of version " + std::to_string(ARM_VERSION) +
                  " and compiled with --into, got version " + std::to_string(about.version));
  if (about.joints != data_.joints)
    throw Refused(scene + ": machine and servo must have the same joints, got " +
                  std::to_string(about.joints) + " and " + std::to_string(data_.joints));
  if (period <= 0 || period % servo_period_ != 0)
    throw Refused(scene + ": update_rate must give a multiple of the servo period " +
                  std::to_string(servo_period_) + " ns, got " + std::to_string(period) + " ns");
  periods_ = period / servo_period_;

  const auto n = at(data_.joints);
  servos_.resize(n), states_.resize(n), demands_.resize(n), commands_.resize(n);
  measured_.resize(n), temperature_.resize(n), q_.resize(n), v_.resize(n), torque_.resize(n);
  readings_.resize(n), modes_.resize(n);
  for (int j = 0; j < joints(); ++j) {
    arm_joint_description one = {};
    one.size = sizeof one;
    describe_joint(j, &one);
    modes_[at(j)] = one.modes & ARM_CURRENT ? ARM_CURRENT : ARM_VOLTAGE;
    if (data_.joint[j].unsensed) modes_[at(j)] = ARM_TORQUE;
    if (!(one.modes & static_cast<std::uint32_t>(modes_[at(j)])))
      throw Refused(scene + ": joints." + data_.name[j] +
                    ".motor must be one that our servo drives");
    servos_[at(j)].joints = 1;
    servos_[at(j)].joint = &data_.joint[j];
    servos_[at(j)].state = &states_[at(j)];
  }
  measurement_.size = sizeof measurement_;
  measurement_.joint = measured_.data();
  command_.size = sizeof command_;
  command_.joint = commands_.data();
  at_.size = sizeof at_;
  at_.joints = data_.joints;
  at_.period = servo_period_;
  at_.measurement = &measurement_;
  for (std::int32_t k = 0; k < about.parameters; ++k) {
    parameters_.push_back({sizeof(arm_parameter), 0, nullptr, 0.0, 0.0});
    describe_parameter(k, &parameters_.back());
  }
  const std::vector<double> numbers = begin_with(varied);
  arm_options options = {};
  options.size = sizeof options;
  options.core = -1;
  options.parameters = numbers.data();
  options.step = about.step;
  options.steps_per_period = about.steps_per_period;
  at_.machine = make(&options);
  if (!at_.machine) throw Refused(scene + ": scene must make a machine, got none");
  try {
    reset(std::vector<double>(n, 0.0));
  } catch (const Refused&) {
    delete_(at_.machine);
    throw;
  }
}

DrivenMachine::~DrivenMachine() { delete_(at_.machine); }

int DrivenMachine::joint(const std::string& name) const {
  std::string valid;
  for (int j = 0; j < joints(); ++j) {
    if (name == data_.name[j]) return j;
    valid += (j ? ", " : "") + std::string(data_.name[j]);
  }
  throw Refused(std::string(data_.scene) + ": joint must be one of the arm, got " + name +
                "; valid: " + valid);
}

int DrivenMachine::varied(const std::string& name) const {
  std::string valid;
  for (std::size_t k = 0; k < parameters_.size(); ++k) {
    if (name == parameters_[k].name) return static_cast<int>(k);
    valid += (k ? ", " : "") + std::string(parameters_[k].name);
  }
  throw Refused(std::string(data_.scene) + ": command_interface must be `power` or a number that " +
                "the scene varies, got " + name + "; valid: " + (valid.empty() ? "none" : valid));
}

std::vector<double> DrivenMachine::begin_with(const std::map<std::string, double>& given) const {
  const std::string faults = "faults.";
  std::vector<double> numbers;
  for (const auto& one : given) (void)varied(one.first);
  for (const arm_parameter& one : parameters_) {
    const std::string name = one.name;
    const auto found = given.find(name);
    if (found == given.end() && name.compare(0, faults.size(), faults) != 0)
      throw Refused(std::string(data_.scene) + ": " + name + " must have an initial_value, as " +
                    "the command_interface of a gpio, got none");
    numbers.push_back(found == given.end() ? 0.0 : found->second);
    if (const double value = numbers.back(); !(value >= one.least && value <= one.most))
      throw Refused(std::string(data_.scene) + ": initial_value of " + name + " must be within " +
                    within(one.least, one.most) + ", got " + std::to_string(value));
  }
  return numbers;
}

std::string DrivenMachine::bounds(int k) const {
  return within(parameters_[at(k)].least, parameters_[at(k)].most);
}

double DrivenMachine::vary(int k) const {
  double value = kUnknown;
  get_parameter_(at_.machine, parameters_[at(k)].name, &value);
  return value;
}

bool DrivenMachine::vary(int k, double value) {
  return set_parameter_(at_.machine, parameters_[at(k)].name, value) == ARM_OK;
}

void DrivenMachine::reset(const std::vector<double>& q) {
  const bool sound = q.size() == states_.size() && std::all_of(q.begin(), q.end(), [](double one) {
                       return std::abs(one) <= kLargest;
                     });
  const std::vector<double> still(states_.size(), 0.0);
  if (!sound || reset_(at_.machine, q.data(), still.data()) != ARM_OK)
    throw Refused(std::string(data_.scene) + ": initial positions must be " +
                  std::to_string(joints()) + " numbers within " + within(-kLargest, kLargest) +
                  " and the stops");
  for (servo& one : servos_) servo_reset_(&one);
  at_.tick = 0;
  tick_measure(&at_);
  for (Demand& one : demands_) one = Demand{one.loop};
  enabled_ = false;
  observe();
  read();
}

void DrivenMachine::enable(bool on) {
  if (on == enabled_) return;
  enabled_ = on;
  for (servo& one : servos_) servo_release_(&one);
  for (Demand& one : demands_) one.given = one.moves = false;
}

void DrivenMachine::power(bool on) {
  power_(at_.machine, on);
  powered_ = on;
}

void DrivenMachine::select(int j, Loop loop) {
  Demand& one = demands_[at(j)];
  if (one.loop != loop) one = Demand{loop};
}

bool DrivenMachine::command(int j, double value) {
  if (!(std::abs(value) <= kLargest)) return false;  // nor is a NaN
  Demand& one = demands_[at(j)];
  one.value = value;
  one.given = true;
  return true;
}

Outcome DrivenMachine::advance() {
  outcome_ = Outcome::advanced;
  period_ = 0;
  const tick_controller controller = {this, answer, take};
  tick_run(&at_, &controller, periods_);
  read();
  return outcome_;
}

// The command of a joint in the servo period to come of the controllers' period.
void DrivenMachine::compute_demand(std::size_t j) {
  Demand& one = demands_[j];
  const servo_joint& joint = data_.joint[j];
  arm_joint_command& out = commands_[j];
  out.mode = modes_[j];
  out.enable = enabled_ ? ARM_ENABLED : 0;
  out.value = 0.0;
  if (!enabled_ || !powered_ || measured_[j].faults) {
    one.moves = one.holds = false;
    servo_release_(&servos_[j]);
    return;
  }
  servo_wish wish;
  wish_within_(&joint, &wish);
  const bool follows = one.loop != Loop::none && one.given && !measured_[j].brake;
  if (!follows) {
    if (!one.holds || measured_[j].brake) one.from = states_[j].theta_measured * joint.ratio;
    wish.q_target = one.from;
  } else if (one.loop == Loop::position) {
    if (!one.moves) one.from = one.value;  // the first position has no speed
    const double part = static_cast<double>(period_ + 1) / static_cast<double>(periods_);
    wish.q_target = one.from + (one.value - one.from) * part;
    wish.v_target = (one.value - one.from) / (1e-9 * static_cast<double>(periods_ * servo_period_));
    if (period_ + 1 == periods_) one.from = one.value;
  } else if (one.loop == Loop::velocity) {
    wish.wants = SERVO_SPEED;
    wish.omega = one.value * joint.motor_turns;
  } else {
    wish.wants = SERVO_CURRENT;
    wish.current = one.value * joint.current_per_tau;
  }
  one.moves = follows;
  one.holds = !follows;
  out.value = servo_drive_(&servos_[j], 0, &wish);
}

const arm_command* DrivenMachine::answer(void* with, const tick_machine* at) {
  DrivenMachine& one = *static_cast<DrivenMachine*>(with);
  for (std::size_t j = 0; j < one.demands_.size(); ++j) one.compute_demand(j);
  ++one.period_;
  one.command_.tick = at->tick;
  return &one.command_;
}

void DrivenMachine::take(void* with, const tick_machine*, int result) {
  DrivenMachine& one = *static_cast<DrivenMachine*>(with);
  one.observe();
  one.outcome_ = std::max(one.outcome_, one.find_outcome(result));
}

Outcome DrivenMachine::find_outcome(int result) const {
  if (result == ARM_DIVERGED) return Outcome::diverged;
  if (result != ARM_OK) return Outcome::refused;
  if (enabled_ && !measurement_.powered) return Outcome::no_power;
  for (const arm_joint_measurement& one : measured_)
    if (enabled_ && one.faults & ARM_FAULT_THERMAL) return Outcome::hot;
  return Outcome::advanced;
}

void DrivenMachine::observe() {
  for (std::size_t j = 0; j < measured_.size(); ++j) {
    const arm_joint_measurement& one = measured_[j];
    servo_observe_(&servos_[j], &one.encoder, &one.current, &one.applied);
  }
}

void DrivenMachine::read() {
  arm_truth truth = {};
  truth.size = sizeof truth;
  truth.q = q_.data();
  truth.v = v_.data();
  truth.gear_torque = torque_.data();
  at_.get_truth(at_.machine, &truth);
  temperatures_(at_.machine, temperature_.data());
  for (std::size_t j = 0; j < readings_.size(); ++j) {
    const servo_joint& joint = data_.joint[j];
    const servo_state& state = states_[j];
    const double current = joint.unsensed ? kUnknown : measured_[j].current;
    readings_[j] = {state.theta_measured * joint.ratio,
                    state.omega * joint.ratio,
                    state.current / joint.current_per_tau,
                    current,
                    temperature_[j],
                    static_cast<double>(measured_[j].encoder),
                    q_[j],
                    v_[j],
                    torque_[j]};
  }
}

}  // namespace arm_emulator_hardware
