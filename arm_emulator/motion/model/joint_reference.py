"""Motions of the joints: known to their end, at a moment, as answered to the servo, or refused."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from arm_emulator.base.arrays import Array
from arm_emulator.base.refusal import Refusal


class ReferenceMotion(Protocol):
    """Motion that the reference follows.

    Attributes:
        duration: [s]; from then on it rests.
    """

    @property
    def duration(self) -> float:
        """See above."""

    def evaluate_at(self, time: float) -> Reference:
        """Return the joints at a time since its begin [s]."""


@dataclass(frozen=True, eq=False)
class Reference:
    """Derivatives of the joints' motion at one moment, not means over a period, (N,) each."""

    q: Array
    """Link angles [rad or m]."""
    v: Array
    """Link speeds [rad/s or m/s]."""
    a: Array
    """Link accelerations [rad/s2 or m/s2]."""
    jerk: Array | None = None
    """Link jerks until they change next [rad/s3 or m/s3]; None: not known."""

    def extrapolate_to(self, period: float, q: Array) -> Reference:
        """Return the motion after a period [s] at whose end the joints are at q (N,)."""
        jerk = np.zeros_like(q) if self.jerk is None else self.jerk
        v = self.v + self.a * period + 0.5 * jerk * period**2
        return Reference(q, v, self.a + jerk * period, jerk)

    @classmethod
    def make_rest(cls, q: Array) -> Reference:
        """Return joints at rest."""
        still = np.zeros_like(q)
        return cls(q, still, still, still)


@dataclass(frozen=True, eq=False)
class JointSetpoint:
    """Joint targets, (N,) each in the motion controller's order of joints."""

    q: Array
    """Link angles [rad or m]."""
    v: Array | None = None
    """Link speeds that belong to them, those of the coming motion period; None: not known."""
    tau: Array | None = None
    """Feed-forward torques of the links [N m or N]; None: unknown."""
    now: Reference | None = None
    """The motion at this moment with all its derivatives, of which `v` is the mean; None: the law
    knows no more than the above."""
    then: Reference | None = None
    """The motion at the end of the period; None: the jerk of `now` lasts until then."""


class PlanningError(Refusal):
    """Raised for a motion on which parts would touch, or the tool would go far past its end."""


class Overshoot(PlanningError):
    """Raised for one on which the tool would go far past its end."""
