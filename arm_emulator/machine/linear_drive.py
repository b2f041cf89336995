"""The linear part of a joint's drive."""

from __future__ import annotations

from dataclasses import dataclass

from arm_emulator.base.by_value import ByValue
from arm_emulator.machine.chain import Array


@dataclass(frozen=True, eq=False)
class LinearDrive(ByValue):
    """The linear part of one joint's drive, as the core states it (core/mechanics/drive.hpp).

    Of a progressive gear it is the linearisation where that is not wound up.

    With its n states z, D dz/dt = F (z, q, v, u), and the torque on the link is G (z, q, v, u) less
    `carried` times the link's acceleration.
    """

    D: Array  # (n,), 0 where a state follows at once
    F: Array  # (n, n + 3)
    G: Array  # (n + 3,)
    carried: float  # kg m2, of a rotor behind a rigid gear
    current: Array  # (n + 3,), A of the motor by (z, q, v, u)
    motor_angle: Array  # (n + 3,), rad

    @classmethod
    def of(cls, row: Array, most: int) -> LinearDrive:
        """Return the drive from a row of ``arm_linear_drives``, with places for `most` states."""
        n, D, rows = int(row[0]), row[2 : 2 + most], row[2 + most :].reshape(most + 3, most + 3)
        rows = rows[:, [*range(n), most, most + 1, most + 2]]
        G, current, motor_angle = rows[most:]
        return cls(D[:n], rows[:n], G, float(row[1]), current, motor_angle)
