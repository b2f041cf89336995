// A client of DrivenMachine, SCENE, by lines: `begin`, `give JOINT EFFORT`, `wait`, `set NAME
// VALUE`, `power 0`. Prints outcome, tick and current of the joint that was given last, or `refused
// WORDS`.
#include <cmath>
#include <iostream>
#include <sstream>

#include "driven_machine.hpp"

using namespace arm_emulator_hardware;

int main(int, char** words) {
  constexpr std::int64_t period = 1000000;
  DrivenMachine arm(words[1], period);
  int joint = arm.joints() - 1;
  std::string line, what, name;
  while (std::getline(std::cin, line)) try {
      std::istringstream in(line);
      double value = 0.0;
      Outcome outcome = Outcome::advanced;
      in >> what;
      if (what == "begin") {
        for (const char* one : {"faults.elbow.command_late", "faults.elbow.command_lost"})
          arm.vary(arm.varied(one), 0.0);
        arm.power(true);
        arm.reset(std::vector<double>(static_cast<std::size_t>(arm.joints()), 0.0));
        arm.enable(true);
        arm.advance();  // a command of the run before is not in it
      } else if (what == "set") {
        in >> name >> value;
        arm.vary(arm.varied(name), value);
      } else if (what == "power") {
        in >> value;
        arm.power(value != 0.0);
      } else {
        if (what == "give") {
          in >> name >> value;
          joint = arm.joint(name);
          arm.select(joint, Loop::effort);
          arm.command(joint, value);
        }
        outcome = arm.advance();
      }
      std::cout << static_cast<int>(outcome) << ' ' << arm.time() / period << ' '
                << arm.reading(joint).current << std::endl;
    } catch (const Refused& why) {
      std::cout << "refused " << why.what() << std::endl;
    }
  return 0;
}
