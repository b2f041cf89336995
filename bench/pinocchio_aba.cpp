// Time of Pinocchio's articulated-body algorithm in C++, for the chain read from standard input:
//   N, then for each joint: axis (3), rotation to the parent (9, row by row), origin in the parent
//   (3), mass, centre of mass (3), inertia about it (xx, xy, yy, xz, yz, zz)
// Prints the median time of a call over some batches [s]. Header-only, so that the whole of it is
// compiled for this machine's processor.
#include <algorithm>
#include <chrono>
#include <iostream>
#include <pinocchio/algorithm/aba.hpp>
#include <pinocchio/multibody.hpp>
#include <vector>

using Clock = std::chrono::steady_clock;

static pinocchio::Model read_model(int joints) {
  const auto number = [] {
    double x;
    std::cin >> x;
    return x;
  };
  pinocchio::Model model;
  pinocchio::JointIndex parent = 0;
  for (int j = 0; j < joints; ++j) {
    Eigen::Vector3d axis, p, c;
    Eigen::Matrix3d R, I;
    for (int k = 0; k < 3; ++k) axis[k] = number();
    for (int k = 0; k < 9; ++k) R(k / 3, k % 3) = number();
    for (int k = 0; k < 3; ++k) p[k] = number();
    const double mass = number();
    for (int k = 0; k < 3; ++k) c[k] = number();
    I(0, 0) = number();
    I(0, 1) = I(1, 0) = number();
    I(1, 1) = number();
    I(0, 2) = I(2, 0) = number();
    I(1, 2) = I(2, 1) = number();
    I(2, 2) = number();
    const pinocchio::SE3 placement(R, p);
    const std::string name = "joint" + std::to_string(j);
    // The kinds that Pinocchio's own URDF reader would choose.
    if (axis == Eigen::Vector3d::UnitX())
      parent = model.addJoint(parent, pinocchio::JointModelRX(), placement, name);
    else if (axis == Eigen::Vector3d::UnitY())
      parent = model.addJoint(parent, pinocchio::JointModelRY(), placement, name);
    else if (axis == Eigen::Vector3d::UnitZ())
      parent = model.addJoint(parent, pinocchio::JointModelRZ(), placement, name);
    else
      parent =
          model.addJoint(parent, pinocchio::JointModelRevoluteUnaligned(axis), placement, name);
    model.appendBodyToJoint(parent, pinocchio::Inertia(mass, c, I), pinocchio::SE3::Identity());
  }
  return model;
}

int main() {
  int joints;
  std::cin >> joints;
  const pinocchio::Model model = read_model(joints);
  pinocchio::Data data(model);
  Eigen::VectorXd q = Eigen::VectorXd::Constant(joints, 0.3);
  const Eigen::VectorXd v = Eigen::VectorXd::Constant(joints, 0.1);
  const Eigen::VectorXd tau = Eigen::VectorXd::Constant(joints, 1.0);
  double sum = 0.0;
  std::vector<double> batches;
  for (int batch = 0; batch < 9; ++batch) {
    const int calls = 500;
    const auto started = Clock::now();
    for (int k = 0; k < calls; ++k) {
      q[0] = 1e-4 * k;
      sum += pinocchio::aba(model, data, q, v, tau, pinocchio::Convention::LOCAL)[0];
    }
    batches.push_back(std::chrono::duration<double>(Clock::now() - started).count() / calls);
  }
  std::sort(batches.begin(), batches.end());
  std::cout << batches[4] << ' ' << sum << '\n';
}
