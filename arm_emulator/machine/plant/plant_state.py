"""The true state of a machine, and its bounds."""

import math
from dataclasses import dataclass

import numpy as np

from arm_emulator.base.array_equality import ArrayEquality
from arm_emulator.base.arrays import Array
from arm_emulator.base.validation.bound import CURRENT, LARGEST_COUNT, POSITION, VELOCITY
from arm_emulator.base.validation.number import Number
from arm_emulator.machine.scene.scene import Scene

SET = ("current", "theta_m", "omega_m", "q", "v")  # what decides on the others of `PlantState`
ROWS = (*SET, "gear_torque")
_UNITS = {"current": "A", "theta_m": "rad", "omega_m": "rad/s"}
_UNITS_OF_LINKS = {
    "revolute": {"q": "rad", "v": "rad/s", "gear_torque": "N m"},
    "prismatic": {"q": "m", "v": "m/s", "gear_torque": "N"},
}


def find_unit(row: str, kind: str) -> str:
    """Return the unit of one of `ROWS` at a revolute or prismatic joint."""
    return (_UNITS | _UNITS_OF_LINKS[kind])[row]


@dataclass(frozen=True, eq=False)
class PlantState(ArrayEquality):
    """True state of the machine at one logical time. Arrays are (N,), base to tool.

    Only the emulator knows it; `Plant.measured` has the readings of the sensors.
    """

    t: float  # s
    current: Array  # A
    theta_m: Array  # rad, motor angle
    omega_m: Array  # rad/s, motor speed
    q: Array  # rad or m, link side
    v: Array  # rad/s or m/s, link side
    gear_torque: Array  # N m or N, on the link


def compute_count_angle(scene: Scene) -> Array:
    """Return the link angle of an encoder count (N,) [rad or m]."""
    return np.array(
        [2.0 * math.pi / joint.counts_per_turn * joint.gear.ratio for joint in scene.joints]
    )


def compute_largest_position(scene: Scene) -> Array:
    """Return the bound of link positions (N,) [rad or m], for exact encoder counts."""
    return np.minimum(POSITION.most, LARGEST_COUNT * np.abs(compute_count_angle(scene)))


def bound_start(scene: Scene) -> tuple[Number, Number]:
    """Return bounds of positions and speeds at the start of a motion."""
    return (
        Number.bound_size("q", "rad or m", compute_largest_position(scene)),
        Number.bound_size("v", "rad/s or m/s", VELOCITY.most),
    )


def bound_state(scene: Scene) -> dict[str, Number]:
    """Return bounds of values that are set, by their names in `PlantState`."""
    largest = compute_largest_position(scene)
    ratio = np.abs(scene.gear_ratios)
    return {
        "current": CURRENT,
        "theta_m": Number.bound_size("motor position", "rad", largest / ratio),
        "omega_m": Number.bound_size("motor velocity", "rad/s", VELOCITY.most / ratio),
        "q": Number.bound_size("position", "rad", largest),
        "v": VELOCITY,
    }
