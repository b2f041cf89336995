// A joint_trajectory_controller moves an emulated arm, cycle by cycle and without a clock.
//
//   trajectory DESCRIPTION CONTROLLERS SECONDS ROWS JOINT=TARGET...
//
// prints a digest of the joints' states in every cycle. Then it prints for each joint its true
// position at the end, the measured one, and the true one at the start. The file ROWS gets a line
// for each
// cycle with `position velocity effort true_position` of each joint; `-`: no file.

#include <cstdio>
#include <cstdlib>

#include "session.hpp"
#include "trajectory_msgs/msg/joint_trajectory.hpp"

namespace {

const char* const kController = "joint_trajectory_controller";
const double kRest = 0.5;  // s after the trajectory

int run(Session& session, double seconds, const char* rows, const std::vector<std::string>& joints,
        const std::vector<double>& target) {
  if (!session.load(kController)) return 2;
  if (!session.change({kController}, {})) return 3;
  trajectory_msgs::msg::JointTrajectory motion;
  motion.joint_names = joints;
  motion.points.resize(1);
  motion.points[0].positions = target;
  motion.points[0].velocities.assign(target.size(), 0.0);
  motion.points[0].time_from_start = rclcpp::Duration::from_seconds(seconds);
  if (!session.send(std::string("/") + kController + "/joint_trajectory", motion)) return 4;

  Digest digest;
  std::ofstream table;
  if (std::strcmp(rows, "-") != 0) table.open(rows);
  table.precision(12);
  Manager& manager = *session.manager;
  std::vector<double> start;
  start.reserve(joints.size());
  for (const auto& joint : joints) start.push_back(manager.state(joint + "/true_position"));
  const double periods = (seconds + kRest) / session.lockstep.period().seconds();
  for (long cycle = 0; cycle < std::lround(periods); ++cycle) {
    if (!session.lockstep.cycle()) return 5;
    for (const auto& joint : joints)
      for (const char* what : {"/position", "/velocity", "/effort", "/true_position"}) {
        const double value = manager.state(joint + what);
        digest.add(value);
        table << value << ' ';
      }
    table << '\n';
  }
  session.lockstep.cycle(false);
  std::printf("digest %016llx\n", static_cast<unsigned long long>(digest.value));
  for (std::size_t j = 0; j < joints.size(); ++j)
    std::printf("%s %.9f %.9f %.9f\n", joints[j].c_str(),
                manager.state(joints[j] + "/true_position"), manager.state(joints[j] + "/position"),
                start[j]);
  return 0;
}

int main_of(int argc, char** argv) {
  if (argc < 6) return 64;
  std::vector<std::string> joints;
  std::vector<double> target;
  for (int k = 5; k < argc; ++k) {
    const std::string word = argv[k];
    joints.push_back(word.substr(0, word.find('=')));
    target.push_back(number(word.c_str() + word.find('=') + 1));
  }
  const char* words[] = {argv[0], "--ros-args", "--log-level", "warn"};
  rclcpp::init(4, words);
  int result = 0;
  {
    Session session(argv[1], argv[2]);
    result = run(session, number(argv[3]), argv[4], joints, target);
  }
  rclcpp::shutdown();
  return result;
}

}  // namespace

int main(int argc, char** argv) {
  return sheltered([&] { return main_of(argc, argv); });
}
