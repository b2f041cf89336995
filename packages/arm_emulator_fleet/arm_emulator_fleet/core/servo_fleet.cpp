// The functions of servo_fleet.h on a processor.
#include "servo_group.hpp"

void servo_fleet_begin(servo_fleet* fleet, int32_t arms) {
  const int32_t groups = (arms + L - 1) / L;
  servo_fleet_end(fleet);
  fleet->lanes = new servo_lanes{new Group[groups], new Joint[int64_t{groups} * fleet->joints]};
  for (int32_t g = 0; g < groups; ++g) begin_servos(*fleet, g, arms);
}

void servo_fleet_end(servo_fleet* fleet) {
  if (!fleet->lanes) return;
  delete[] fleet->lanes->group;
  delete[] fleet->lanes->joint;
  delete fleet->lanes;
  fleet->lanes = nullptr;
}

void servo_fleet_reset(servo_fleet* fleet, int32_t arms, const uint8_t* mask) {
  for (int32_t k = 0; k < arms; ++k)
    if (mask[k]) reset_servo(*fleet, k);
}

void servo_fleet_aim(servo_fleet* fleet, int32_t arms) {
  for (int32_t k = 0; k < arms; ++k) update_targets(*fleet, k);
}

void servo_fleet_retune(servo_fleet* fleet, int32_t arm, const servo_joint* joint) {
  retune_servo(*fleet, arm, joint);
}
