"""A measured motion of one shaft, for the torques of parts."""

from dataclasses import dataclass

from arm_emulator.base.arrays import Array


@dataclass(frozen=True)
class ShaftMotion:
    """Evenly spaced samples of a rotor or of a link. Arrays are (K,)."""

    t: Array  # s
    angle: Array  # rad, or m of a link that slides
    speed: Array  # rad/s
    acceleration: Array  # rad/s2
    gear_torque: Array  # N m, of the gear, seen at this shaft; of a rigid one the motor's
    motor_torque: Array  # N m, by the motor's constants, seen at this shaft
    ratio: float  # of the gear: turns of the link per turn of the motor
