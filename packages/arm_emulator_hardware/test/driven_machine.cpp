// A client of DrivenMachine: SCENE PERIOD CYCLES SEED; prints readings, or the line of a refusal.
#include "driven_machine.hpp"

#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <map>

using namespace arm_emulator_hardware;

namespace {

void print(const char* what, const DrivenMachine& arm) {
  std::printf("%s", what);
  for (int j = 0; j < arm.joints(); ++j) {
    const JointReading& one = arm.reading(j);
    for (double value : {one.position, one.velocity, one.effort, one.current, one.motor_counts,
                         one.true_position, one.true_velocity, one.true_effort})
      std::printf(" %.17g", value);
  }
  std::printf("\n");
}

void go(DrivenMachine& arm, int cycles, Loop loop, double value, const char* what) {
  for (int k = 0; k < cycles; ++k) {
    for (int j = 0; j < arm.joints(); ++j) arm.select(j, loop), arm.command(j, value);
    arm.advance();
  }
  print(what, arm);
}

// A quintic way of all joints from where they rest.
void move(DrivenMachine& arm, double seconds, double period, double to) {
  const double from = arm.reading(0).position;
  double worst = 0.0;
  for (int k = 1; k <= static_cast<int>(seconds / period); ++k) {
    const double s = k * period / seconds, way = s * s * s * (10.0 + s * (6.0 * s - 15.0));
    const double q = from + way * (to - from);
    for (int j = 0; j < arm.joints(); ++j) arm.select(j, Loop::position), arm.command(j, q);
    arm.advance();
    for (int j = 0; j < arm.joints(); ++j)
      worst = std::fmax(worst, std::fabs(arm.reading(j).true_position - q));
  }
  std::printf("worst %.17g\n", worst);
  print("moved", arm);
}

// Switches of loops, of drives and of power, in any order; every reading stays finite.
int shake(DrivenMachine& arm, int cycles, unsigned seed) {
  int bad = 0, cut = 0;
  for (int k = 0; k < cycles; ++k) {
    seed = seed * 1664525U + 1013904223U;
    const unsigned draw = seed >> 16;
    const int j = static_cast<int>(draw % static_cast<unsigned>(arm.joints()));
    if (draw % 97 == 0) arm.power(!arm.powered());
    if (draw % 131 == 0) arm.enable(draw % 2);
    if (draw % 7 == 0) arm.select(j, static_cast<Loop>(draw / 7 % 4));
    if (draw % 5 == 0) arm.command(j, (static_cast<double>(draw % 1001) - 500.0) / 1000.0);
    const Outcome outcome = arm.advance();
    cut += outcome == Outcome::no_power;
    bad += outcome == Outcome::refused || outcome == Outcome::diverged;
    for (int i = 0; i < arm.joints(); ++i) bad += !std::isfinite(arm.reading(i).velocity);
  }
  std::printf("bad %d cut %d\n", bad, cut);
  print("shaken", arm);
  return bad;
}

}  // namespace

int main(int count, char** words) {
  if (count != 5) return 2;
  const long period = std::atol(words[2]);
  try {
    DrivenMachine arm(words[1], period);
    const std::vector<double> zero(static_cast<std::size_t>(arm.joints()), 0.0);
    const int second = static_cast<int>(1000000000L / period);
    arm.enable(true);
    move(arm, 1.0, 1e-9 * static_cast<double>(period), 0.3);
    go(arm, second / 2, Loop::position, 0.3, "held");
    arm.reset(zero);
    arm.enable(true);
    go(arm, second / 2, Loop::velocity, 0.4, "speed");
    go(arm, second / 2, Loop::velocity, 0.4, "speed");
    arm.reset(zero);
    arm.enable(true);
    go(arm, second / 50, Loop::effort, 10.0, "effort");
    arm.power(false);
    arm.command(0, 0.1);
    std::printf("without power %d\n", arm.advance() == Outcome::no_power);
    arm.power(true);
    const std::int64_t before = arm.time();
    int taken = 0;
    for (const double wrong : {std::nan(""), HUGE_VAL, -HUGE_VAL, 1e300})
      taken += arm.command(0, wrong);
    const bool went_on = arm.advance() == Outcome::advanced && arm.time() > before;
    std::printf("wrong %d %d\n", taken, went_on && std::isfinite(arm.reading(0).true_position));
    arm.reset(zero);
    arm.enable(true);
    const int slip = arm.varied("faults.elbow.encoder_slips");
    const bool kept =
        !arm.vary(slip, 1e9) && !arm.vary(slip, std::nan("")) && arm.vary(slip) == 0.0;
    std::printf("bounds %d %d\n", kept, arm.vary(slip, 10.0) && arm.vary(slip) == 10.0);
    go(arm, second, Loop::position, 0.0, "slipped");
    arm.vary(slip, 0.0);
    arm.reset(zero);
    arm.enable(true);
    shake(arm, std::atoi(words[3]), static_cast<unsigned>(std::atoi(words[4])));
    std::printf("time %lld\n", static_cast<long long>(arm.time()));
  } catch (const Refused& error) {
    std::printf("%s\n", error.what());
    return 0;
  }
  const std::map<std::string, double> wrong[] = {{{"faults.wrist", 1.0}},
                                                 {{"faults.elbow.command_late", 99.0}}};
  for (const auto& varied : wrong) try {
      DrivenMachine(words[1], period, varied);
    } catch (const Refused& error) {
      std::printf("%s\n", error.what());
    }
  try {
    DrivenMachine(words[1], period).joint("no_such_joint");
  } catch (const Refused& error) {
    std::printf("%s\n", error.what());
  }
  return 0;
}
