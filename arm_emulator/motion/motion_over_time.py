"""A motion of the joints that is known to its end."""

from __future__ import annotations

from typing import Protocol

from arm_emulator.motion.reference import Reference


class Motion(Protocol):
    """Motion that the reference follows.

    Attributes:
        duration: [s]; from then on it rests.
    """

    @property
    def duration(self) -> float:
        """See above."""

    def at(self, time: float) -> Reference:
        """Return the joints at a time since its begin [s]."""
