// What a unit tells of its variables: a table in the order of their value references. The exporter
// writes it (variables.py), from the same list as modelDescription.xml.
#pragma once

namespace fmu {

enum class Type { float64, int64, int32, boolean };

enum class Role {
  independent,  // time
  fixed,        // a parameter that is set before the motion begins
  tunable,      // a parameter that may be set between two steps
  input,
  output
};

// Where the values are. Rows have an entry per joint unless something else is said.
enum class Quantity {
  time,
  // Inputs.
  command,
  command_d,
  enable,
  close_brake,
  power,
  external_force,  // three per joint, and so are moments and points
  external_moment,
  external_point,
  external_world_axes,
  // Parameters.
  start_q,
  start_v,
  parameter,  // one per varied number of the scene
  // What is measured.
  encoder_counts,
  current,
  current_d,
  applied,
  faults,
  powered,
  brake_closed,
  index_counts,
  index_pulses,
  link_encoder_counts,
  link_index_counts,
  link_index_pulses,
  torque,
  specific_force,  // three per inertial measurement unit, and so are angular rates
  angular_rate,
  // The truth.
  truth_q,
  truth_v,
  truth_gear_torque,
  truth_motor_angle,
  truth_motor_speed,
  truth_current,
  truth_energy,
  truth_winding_temperature,
};

// `count` values of a quantity, from `first` on.
struct Variable {
  Type type;
  Role role;
  Quantity quantity;
  int first, count;
};

}  // namespace fmu
