"""True states of many arms."""

from __future__ import annotations

from dataclasses import dataclass

from arm_emulator.base.by_value import ByValue
from arm_emulator.machine.chain import Array


@dataclass(frozen=True, eq=False)
class FleetState(ByValue):
    """True states of all arms: a row each, and in a row the joints, base to tool."""

    t: Array  # (count,) s; arms that have diverged stay where they are
    energy: Array  # (count,) J
    current: Array  # (count, N) A
    theta_m: Array  # rad, motor angle
    omega_m: Array  # rad/s, motor speed
    q: Array  # rad or m, link side
    v: Array  # rad/s or m/s, link side
    gear_torque: Array  # N m or N, on the link
