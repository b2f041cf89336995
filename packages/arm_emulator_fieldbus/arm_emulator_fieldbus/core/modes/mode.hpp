// Interface of a mode of operation (0x6060).
//
// A mode is constructed each time it is chosen. In Operation enabled it sets the demands of the
// inner loops in every period; the drive enables, stops and publishes.
#pragma once

#include <limits>

#include "../axis.hpp"
#include "../cia402.hpp"

namespace fieldbus {

// Static properties of a mode.
struct AboutMode {
  int number = 0;  // 0x6060
  const char* name = "none";
  std::uint32_t loops = 0;       // bits of enum drives_loops that it closes
  bool follows = false;          // the following error is watched
  bool within_limits = true;     // software limits hold
  bool halts_in_torque = false;  // a halt takes the torque away
};

// Offsets that a master adds to the demands of the inner loops.
struct Offsets {
  double speed = 0.0;   // counts/s
  double torque = 0.0;  // 0.1 %
};

// Inputs of the mode's bits of the statusword.
struct Situation {
  bool operates;  // Operation enabled
  bool stops;     // ... and about to leave it
  bool halted;    // slowed down by a stop or a halt
  bool off;       // the following error is beyond its window

  // Bit 12 of the cyclic modes: the drive follows the targets.
  std::uint16_t follows() const { return operates && !stops && !halted ? status::bit12 : 0; }
};

class Mode {
 public:
  // The motor is not controlled: start at its present state.
  virtual void hold(Axis&) {}
  // The motor moves in another mode: continue from there.
  virtual void take_over(Axis&) {}
  // A stop has ended; `by_halt`: it was a halt, and the interrupted motion continues.
  virtual void resume(Axis& axis, bool /*by_halt*/) { take_over(axis); }
  // Set the demands of a period.
  virtual void run(Axis& axis) { axis.hold_standstill(); }
  virtual Offsets compute_offsets(const Axis&) const { return {}; }
  // 0.1 %, beside the limits that the dictionary has for all modes.
  virtual double find_torque_limit(const Axis&) const {
    return std::numeric_limits<double>::infinity();
  }
  // A period was measured.
  virtual void look(const Axis&) {}
  // Bits of the statusword.
  virtual std::uint16_t compute_status(const Axis&, const Situation&) const { return 0; }

 protected:
  ~Mode() = default;
};

// 0x6060 is 0: the motor is held.
class NoMode final : public Mode {
 public:
  static constexpr AboutMode about = {};
};

}  // namespace fieldbus
