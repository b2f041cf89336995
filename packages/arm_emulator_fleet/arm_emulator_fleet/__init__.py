"""Many arms of one scene in one process, and our servo on each of them."""

from arm_emulator_fleet.fleet import Fleet
from arm_emulator_fleet.fleet_control import FleetControl, FleetFrame
from arm_emulator_fleet.fleet_machines import FleetState
from arm_emulator_fleet.fleet_schedule import FleetWay
from arm_emulator_fleet.servo_fleet import ServoFleet

__all__ = ["Fleet", "FleetControl", "FleetFrame", "FleetState", "FleetWay", "ServoFleet"]
