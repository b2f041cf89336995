"""Answer of a motion controller for a motion period."""

from __future__ import annotations

from dataclasses import dataclass

from arm_emulator.base.given import FloatArray
from arm_emulator.motion.reference import Reference


@dataclass(frozen=True, eq=False)
class Instruction:
    """Joint targets, (N,) each in the motion controller's order of joints."""

    q: FloatArray
    """Link angles [rad or m]."""
    v: FloatArray | None = None
    """Link speeds that belong to them, those of the coming motion period; None: not known."""
    tau: FloatArray | None = None
    """Feed-forward torques of the links [N m or N]; None: unknown."""
    now: Reference | None = None
    """The motion at this moment with all its derivatives, of which `v` is the mean; None: the law
    knows no more than the above."""
    then: Reference | None = None
    """The same at the end of the period; None: the jerk of `now` lasts until then."""
