"""Gains of a joint's servo, computed from its data sheets."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class MotorData:
    """Winding, rotor and encoder of a motor, as in a scene or a data sheet."""

    resistance: float  # ohm
    inductance: float  # H; 0: the current follows the voltage at once
    torque_constant: float  # N m/A
    back_emf_constant: float  # V s/rad
    rotor_inertia: float  # kg m2, with the gear's primary side
    counts_per_turn: int | None = None  # of the encoder; None: as good as ideal


@dataclass(frozen=True)
class GearData:
    """Gear between motor and link. N m (N) are those of the joint, rad (m) as well."""

    ratio: float = 1.0  # link turns per motor turn (m per rad for a prismatic joint)
    stiffness: float | None = None  # N m/rad at the link; None: rigid
    damping: float = 0.0  # N m s/rad at the link


@dataclass(frozen=True)
class ServoGains:
    """What `JointServo` takes beside the data sheet."""

    position_gain: float  # 1/s
    velocity_gain: float  # N m s/rad, at the link
    integral_time: float  # s
    observer_bandwidth: float  # rad/s


def design(
    motor: MotorData,
    gear: GearData,
    link_inertia: tuple[float, float],
    period: float,
    viscous: float = 0.0,
) -> ServoGains:
    """Return gains that hold for every link inertia in a range.

    Args:
        motor: the motor.
        gear: the gear.
        link_inertia: least and largest inertia of what the joint moves, over all poses and
            payloads, the other joints held [kg m2, kg].
        period: servo period [s].
        viscous: friction at the link [N m s/rad].
    """
    least, most = link_inertia
    reflected = motor.rotor_inertia / gear.ratio**2
    if gear.stiffness is None:
        reflected += least
        velocity_gain = reflected * 0.15 / period
    else:
        velocity_gain = 1.5 * math.sqrt(gear.stiffness * reflected)
        velocity_gain = min(velocity_gain, reflected * 0.25 / period)
        most += reflected
    position_gain = min(0.3 * velocity_gain / most, 0.03 / period)
    return ServoGains(position_gain, velocity_gain, 6.0 / position_gain, 0.3 / period)
