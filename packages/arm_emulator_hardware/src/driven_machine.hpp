// A compiled scene and the inner loops of its drives, advanced in whole servo periods. No ROS.
#pragma once

#include <dlfcn.h>

#include <cstdint>
#include <map>
#include <memory>
#include <stdexcept>
#include <string>
#include <vector>

#include "arm.h"
#include "servo_data.h"
#include "tick.h"

namespace arm_emulator_hardware {

// Bad input: `where: quantity must satisfy rule, got value; valid: ...`, one line.
struct Refused : std::runtime_error {
  using std::runtime_error::runtime_error;
};

enum class Loop { none, position, velocity, effort };

enum class Outcome {
  advanced,
  no_power,  // the motors got no command
  hot,       // a winding is beyond its limit: its motor got no command
  refused,   // by the machine, of what it was given: nothing has changed
  diverged,  // the machine stays at its last sound state until `reset`
};

// State of a joint; SI, of the link unless stated. Numbers of absent sensors are NaN.
struct JointReading {
  double position, velocity;  // by the encoder at the motor and the servo's observer
  double effort;              // N m or N at the link, by the motor's current
  double current;             // A
  double temperature;         // degC of the winding
  double motor_counts;        // of the encoder at the motor
  double true_position, true_velocity, true_effort;  // for judging, not for control
};

// Bounds as text.
std::string within(double least, double most);

// A shared library and its functions by name.
class SharedLibrary {
 public:
  // Null functions, and a reason, where the file is no library.
  explicit SharedLibrary(const std::string& file)
      : handle_(dlopen(file.c_str(), RTLD_NOW | RTLD_LOCAL)) {
    if (!handle_) why_ = dlerror();
  }
  const std::string& why() const { return why_; }

  // Set `function` to that of the name; false if no function has it.
  template <class Function>
  bool find(const char* name, Function*& function) const {
    function = handle_ ? reinterpret_cast<Function*>(dlsym(handle_.get(), name)) : nullptr;
    return function != nullptr;
  }

 private:
  struct Close {
    void operator()(void* handle) const { dlclose(handle); }
  };
  std::unique_ptr<void, Close> handle_;
  std::string why_;
};

class DrivenMachine {
 public:
  // Open FOLDER/NAME of `arm_emulator compile NAME --servo --into FOLDER`; `period` [ns] is that of
  // the controllers. `varied`: values of the scene's varied numbers to begin with, by name; faults
  // that are not among them are off. Throws Refused.
  DrivenMachine(const std::string& scene, std::int64_t period,
                const std::map<std::string, double>& varied = {});
  ~DrivenMachine();
  DrivenMachine(const DrivenMachine&) = delete;
  DrivenMachine& operator=(const DrivenMachine&) = delete;

  int joints() const { return static_cast<int>(states_.size()); }
  // Throws Refused where the scene has no such joint.
  int joint(const std::string& name) const;
  std::int64_t time() const { return at_.tick * servo_period_; }  // ns
  bool powered() const { return powered_; }

  // Go to rest at `q`, at tick 0, drives disabled. Throws Refused.
  void reset(const std::vector<double>& q);
  // Disabled drives get no command, and their brakes close.
  void enable(bool on);
  void power(bool on);
  // Select the loop that a joint's command goes to; `none` holds the joint where it stands.
  void select(int j, Loop loop);
  Loop selected(int j) const { return demands_[static_cast<std::size_t>(j)].loop; }
  // False: the value is not finite, or its size beyond `kLargest`; the joint's command stays.
  static constexpr double kLargest = 1e9;
  bool command(int j, double value);
  // A varied number by its name. Throws Refused where the scene has none of that name.
  int varied(const std::string& name) const;
  double vary(int k) const;
  // Set it; the motion goes on. False: the value is not within its bounds, and nothing has changed.
  bool vary(int k, double value);
  std::string bounds(int k) const;  // as text
  bool enabled() const { return enabled_; }
  // Go through one period of the controllers.
  Outcome advance();
  const JointReading& reading(int j) const { return readings_[static_cast<std::size_t>(j)]; }

 private:
  struct Demand {
    Loop loop = Loop::none;
    double value = 0.0, from = 0.0;  // positions: at the end and the start of the period
    bool given = false, moves = false, holds = false;
  };

  std::vector<double> begin_with(const std::map<std::string, double>& varied) const;
  void compute_demand(std::size_t j);
  static const arm_command* answer(void* with, const tick_machine* at);
  static void take(void* with, const tick_machine* at, int result);
  Outcome find_outcome(int result) const;
  void observe();
  void read();

  SharedLibrary machine_library_, servo_library_;
  servo_data data_ = {};
  std::int64_t servo_period_ = 0, periods_ = 1, period_ = 0;
  Outcome outcome_ = Outcome::advanced;  // of the controllers' period
  bool enabled_ = false, powered_ = true;

  int (*reset_)(arm_machine*, const double*, const double*) = nullptr;
  void (*temperatures_)(const arm_machine*, double*) = nullptr;
  void (*power_)(arm_machine*, int) = nullptr;
  int (*get_parameter_)(const arm_machine*, const char*, double*) = nullptr;
  int (*set_parameter_)(arm_machine*, const char*, double) = nullptr;
  void (*delete_)(arm_machine*) = nullptr;
  decltype(&servo_reset) servo_reset_ = nullptr;
  decltype(&servo_observe) servo_observe_ = nullptr;
  decltype(&servo_drive) servo_drive_ = nullptr;
  decltype(&servo_release) servo_release_ = nullptr;
  decltype(&servo_wish_within) wish_within_ = nullptr;

  tick_machine at_ = {};
  arm_measurement measurement_ = {};
  std::vector<arm_parameter> parameters_;
  std::vector<servo> servos_;  // of a joint each, whose loops are commanded apart
  std::vector<servo_state> states_;
  std::vector<std::int32_t> modes_;
  std::vector<Demand> demands_;
  arm_command command_ = {};
  std::vector<arm_joint_command> commands_;
  std::vector<arm_joint_measurement> measured_;
  std::vector<double> temperature_, q_, v_, torque_;
  std::vector<JointReading> readings_;
};

}  // namespace arm_emulator_hardware
