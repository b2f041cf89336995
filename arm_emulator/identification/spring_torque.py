"""Torques on links that go with the angle alone, as `core/counterbalance.hpp` and tables give."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import PPoly

from emulator_node.chain import Array
from emulator_node.parts.counterbalance import Counterbalance
from emulator_node.parts.torque_table import TorqueTable
from emulator_node.scene import Joint


def spring_torque(spring: Counterbalance, q: Array, force: float, stiffness: float) -> Array:
    """Return the torque of a spring with another force and stiffness, at angles q [N m]."""
    a, b, at = spring.base_distance, spring.link_distance, q - spring.angle
    l = np.sqrt(a * a + b * b - 2.0 * a * b * np.cos(at))  # noqa: E741
    longer = l - spring.length
    if spring.gas_column:
        h = spring.gas_column
        F = force * h / (h + np.copysign(1.0, spring.force) * longer)
    else:
        F = force - stiffness * longer
    torque: Array = F * a * b * np.sin(at) / l
    return torque


def table_torque(table: TorqueTable, q: Array) -> Array:
    """Return the torque of a table at angles q [N m or N]."""
    at = np.array(table.angles)
    if table.periodic:
        within = at[0] + np.mod(q - at[0], at[-1] - at[0])
    else:
        within = np.clip(q, at[0], at[-1])
    torque: Array = PPoly(table.coefficients()[::-1], at)(within)
    return torque


def known_torque(joint: Joint, q: Array) -> Array:
    """Return what springs and tables at a joint's link do at angles q [N m or N]."""
    torque = np.zeros_like(q)
    for part in joint.extras:
        if isinstance(part, Counterbalance):
            torque += spring_torque(part, q, part.force, part.stiffness)
        if isinstance(part, TorqueTable):
            torque += table_torque(part, q)
    return torque
