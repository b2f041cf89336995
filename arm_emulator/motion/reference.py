"""A motion of the joints that is known to its end."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from arm_emulator.base.given import FloatArray


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


@dataclass(frozen=True, eq=False)
class Reference:
    """Derivatives of the joints' motion at one moment, not means over a period, (N,) each."""

    q: FloatArray
    """Link angles [rad or m]."""
    v: FloatArray
    """Their speeds [rad/s or m/s]."""
    a: FloatArray
    """Their accelerations [rad/s2 or m/s2]."""
    jerk: FloatArray | None = None
    """Their jerks until the next change of them [rad/s3 or m/s3]; None: not known."""

    @classmethod
    def at_rest(cls, q: FloatArray) -> Reference:
        """Return joints at rest."""
        still = np.zeros_like(q)
        return cls(q, still, still, still)
