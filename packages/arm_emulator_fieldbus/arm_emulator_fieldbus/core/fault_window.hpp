// The faults of a machine, one at a time: its number is chosen, then its name and its magnitude
// can be read, and the magnitude set. All drives show those of the whole machine.
#pragma once

#include <cstring>

#include "values.hpp"

namespace fieldbus {

class FaultWindow {
 public:
  static constexpr std::uint16_t kCount = 0x2010, kNumber = 0x2011, kName = 0x2012,
                                 kMagnitude = 0x2013;

  explicit FaultWindow(const drives_machine& machine) : machine_(machine) {}

  // Choose the first fault, if there is one.
  void begin(Values& values) const {
    values.set<kCount>(machine_.faults);
    choose(values, machine_.faults ? 1 : 0);
  }
  // Return 0, or the abort code of a number that no fault has.
  std::uint32_t choose(Values& values, std::int64_t number) const {
    if (number > machine_.faults) return abort_code::too_high;
    values.set<kNumber>(number);
    values.set_text(kName, number ? name(number) : "none");
    return abort_code::none;
  }
  // Set the magnitude of the chosen fault, from now on; its bits are those of a double.
  std::uint32_t set(const Values& values, std::int64_t magnitude) const {
    const std::int64_t number = values.get<kNumber>();
    if (!number) return abort_code::state;
    const int result = machine_.set_parameter(machine_.at->machine, name(number),
                                              std::bit_cast<double>(magnitude));
    return result == ARM_OK ? abort_code::none : abort_code::out_of_range;
  }
  // Take the present magnitude, which any door may have set, into its entry.
  void show(Values& values) const {
    double magnitude = 0.0;
    const std::int64_t number = values.get<kNumber>();
    if (number) machine_.get_parameter(machine_.at->machine, name(number), &magnitude);
    values.set<kMagnitude>(std::bit_cast<std::int64_t>(magnitude));
  }

 private:
  const char* name(std::int64_t number) const { return machine_.fault[number - 1]; }

  const drives_machine& machine_;
};

}  // namespace fieldbus
