"""Electrical model behind a motor's command, so that one servo law serves voltages and currents.

A drive that closes a current loop of bandwidth f makes of a command u [A] the current

    1 / (2 pi f) di/dt = u - i

at any speed. That is the winding L di/dt = V - R i - Kb omega with R = 1, L = 1 / (2 pi f) and
Kb = 0, whose volts are amperes. So it is with a drive that makes a torque of its command, whose
volts and amperes are N m.
"""

from __future__ import annotations

import math
from typing import NamedTuple


class Commanded(NamedTuple):
    """The winding that a command meets: L di/dt = u - R i - Kb omega."""

    resistance: float
    inductance: float
    back_emf_constant: float

    @classmethod
    def by(
        cls,
        resistance: float,
        inductance: float,
        back_emf_constant: float,
        bandwidth: float,
    ) -> Commanded:
        """Return what a motor's command meets.

        Args:
            resistance: of the winding [ohm].
            inductance: of the winding [H].
            back_emf_constant: [V s/rad].
            bandwidth: of the drive's loop of the current or the torque [Hz]; 0: the command is a
                voltage.
        """
        if bandwidth > 0.0:
            return cls(1.0, 1.0 / (2.0 * math.pi * bandwidth), 0.0)
        return cls(resistance, inductance, back_emf_constant)
