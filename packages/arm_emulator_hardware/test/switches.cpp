// Controllers take turns, power is cut, windings get hot and the machine diverges: thousands of
// cycles of an emulated arm.
//
//   switches DESCRIPTION CONTROLLERS COMPONENT CYCLES SEED HOT JOINT...
//
// CONTROLLERS has, besides joint_trajectory_controller, the forward_command_controllers `position`,
// `velocity`, `effort` and `power`, and `stiffness` of a gear, where the machine can diverge. HOT:
// effort that makes a winding too hot. Prints how often what happened, how many states of the
// joints were not finite, the largest true speed, and a digest of all states.

#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <map>

#include "session.hpp"
#include "std_msgs/msg/float64_multi_array.hpp"
#include "trajectory_msgs/msg/joint_trajectory.hpp"

namespace {

const char* const kTrajectory = "joint_trajectory_controller";
const char* const kControllers[] = {kTrajectory, "position", "velocity", "effort"};
const char* const kPower = "power";
const char* const kStiffness = "stiffness";
constexpr long kTurn = 40, kCut = 970, kWrong = 210, kHeat = 1130, kBreak = 1510;  // cycles between
constexpr long kSoon = 200, kShake = 5, kCooling = 500;                            // cycles
constexpr double kTooStiff = 1e9;                                                  // N m/rad
constexpr double kStep = 0.05, kSpeed = 0.3, kEffort = 3.0;  // rad, rad/s, N m

struct Random {
  std::uint64_t state;
  double within(double size) {  // of -size .. size
    state = state * 6364136223846793005u + 1442695040888963407u;
    return size * (2.0 * static_cast<double>(state >> 11) / 9007199254740992.0 - 1.0);
  }
};

class Turns {
 public:
  Turns(Session& session, std::string component, std::uint64_t seed, double hot,
        std::vector<std::string> joints)
      : session_(session),
        component_(std::move(component)),
        random_{seed},
        hot_(hot),
        joints_(std::move(joints)) {}

  bool begin() {
    for (const char* one : kControllers)
      if (!session_.load(one)) return false;
    if (session_.load(kStiffness)) others_.push_back(kStiffness);
    return session_.load(kPower) && session_.change(others_, {});
  }

  bool go(long cycles) {
    for (long k = 1; k <= cycles; ++k) {
      if (k % kTurn == 0 && !turn()) return false;
      if (k % kCut == 0 && !cut()) return false;
      if (k % kWrong == 0 && !wrong()) return false;
      if (k % kHeat == 0 && !heat()) return false;
      if (k % kBreak == 0 && others_.size() > 1 && !diverge()) return false;
      if (!session_.lockstep.cycle()) return false;
      look();
    }
    return true;
  }

  void print() const {
    for (const auto& [what, count] : count_) std::printf("%s %ld\n", what.c_str(), count);
    std::printf("not_finite %ld\nfastest %.6f\ndigest %016llx\n", not_finite_, fastest_,
                static_cast<unsigned long long>(digest_.value));
  }

 private:
  double at(const std::string& joint, const char* what) {
    return session_.manager->state(joint + "/" + what);
  }

  void look() {
    for (const auto& joint : joints_) {
      for (const char* what : {"position", "velocity", "effort", "current", "motor_counts",
                               "true_position", "true_velocity", "true_effort"}) {
        const double value = at(joint, what);
        not_finite_ += !std::isfinite(value);
        digest_.add(value);
      }
      fastest_ = std::max(fastest_, std::abs(at(joint, "true_velocity")));
    }
  }

  std::vector<std::string> stopped() const {
    return active_.empty() ? std::vector<std::string>{} : std::vector<std::string>{active_};
  }

  bool turn() {
    const auto next = static_cast<std::size_t>(random_.within(2.0) + 2.0) % std::size(kControllers);
    return turn_to(kControllers[next]) && command();
  }

  bool turn_to(const std::string& next) {
    if (next == active_) return true;
    if (!session_.change({next}, stopped())) return false;
    active_ = next;
    ++count_["switches"];
    return true;
  }

  bool command() {
    if (active_ == kTrajectory) {
      trajectory_msgs::msg::JointTrajectory motion;
      motion.joint_names = joints_;
      motion.points.resize(1);
      for (const auto& joint : joints_)
        motion.points[0].positions.push_back(at(joint, "position") + random_.within(kStep));
      motion.points[0].time_from_start = rclcpp::Duration::from_seconds(0.06);
      return session_.send(std::string("/") + kTrajectory + "/joint_trajectory", motion);
    }
    std::vector<double> values;
    values.reserve(joints_.size());
    for (const auto& joint : joints_)
      values.push_back(active_ == "position" ? at(joint, "position") + random_.within(0.01 * kStep)
                       : active_ == "velocity" ? random_.within(kSpeed)
                                               : random_.within(kEffort));
    return send(active_, values);
  }

  bool send(const std::string& controller, const std::vector<double>& values) {
    std_msgs::msg::Float64MultiArray message;
    message.data = values;
    return session_.send("/" + controller + "/commands", message);
  }

  // Command what no drive can do: it is refused, and the arm goes on.
  bool wrong() {
    if (active_.empty() || active_ == kTrajectory) return true;
    for (const double value : {HUGE_VAL, -HUGE_VAL, 1e300})
      if (!send(active_, std::vector<double>(joints_.size(), value))) return false;
    session_.lockstep.cycle();
    if (session_.manager->component(component_) != "active") return false;
    ++count_["wrong"];
    return true;
  }

  // Cut the power: drives and their controllers stop. Then all begin again.
  bool cut() {
    if (!send(kPower, {0.0})) return false;
    session_.lockstep.cycle();
    session_.lockstep.cycle();
    if (session_.manager->component(component_) != "inactive") return false;
    ++count_["cuts"];
    return again();
  }

  // Go on for so many cycles while the component is active; true: it is in this state then.
  bool falls_to(const std::string& state, long cycles) {
    for (long k = 0; k < cycles && session_.manager->component(component_) == "active"; ++k)
      if (!session_.lockstep.cycle()) return false;
    return session_.manager->component(component_) == state;
  }

  // Shake the arm until drives trip by their copper loss. While it rests, they cool.
  bool heat() {
    if (!turn_to("effort")) return false;
    bool is_hot = false;
    for (long k = 0; k < kSoon && !is_hot; ++k) {
      const double effort = k % 2 ? hot_ : -hot_;
      if (!send("effort", std::vector<double>(joints_.size(), effort))) return false;
      is_hot = falls_to("inactive", kShake);
    }
    if (!is_hot) return false;
    ++count_["hot"];
    for (long k = 0; k < kCooling; ++k) {
      if (!session_.lockstep.cycle()) return false;
      look();
    }
    return again();
  }

  // The scheme's step is too long for the gear: the component is configured anew.
  bool diverge() {
    if (!send(kStiffness, {kTooStiff}) || !falls_to("unconfigured", kSoon)) return false;
    ++count_["diverged"];
    return again();
  }

  bool again() {
    active_.clear();
    return session_.manager->activate(component_) && session_.change(others_, {});
  }

  Session& session_;
  std::string component_;
  Random random_;
  double hot_;
  std::vector<std::string> joints_;
  std::vector<std::string> others_ = {kPower};  // controllers beside the one of the joints
  std::string active_;
  std::map<std::string, long> count_;
  long not_finite_ = 0;
  double fastest_ = 0.0;
  Digest digest_;
};

int main_of(int argc, char** argv) {
  if (argc < 8) return 64;
  const char* words[] = {argv[0], "--ros-args", "--log-level", "fatal"};
  rclcpp::init(4, words);
  bool whole = false;
  {
    Session session(argv[1], argv[2]);
    Turns turns(session, argv[3], std::strtoull(argv[5], nullptr, 10), number(argv[6]),
                {argv + 7, argv + argc});
    whole = turns.begin() && turns.go(std::lround(number(argv[4])));
    turns.print();
  }
  rclcpp::shutdown();
  return whole ? 0 : 2;
}

}  // namespace

int main(int argc, char** argv) {
  return sheltered([&] { return main_of(argc, argv); });
}
