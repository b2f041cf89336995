"""Joints while some of them cannot move, without power or with closed brakes."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from arm_emulator.base.given import FloatArray
from arm_emulator.motion.instruction import Instruction
from arm_emulator.motion.laws import Laws, smooth_joints
from arm_emulator.motion.reference import Reference

Flags = npt.NDArray[np.bool_]


class Standstill:
    """The reference of an arm that waits.

    A joint that cannot move is commanded to be where it is measured, as fast as it is, so that its
    brake never opens on a difference. The others come to rest, from their commanded motion
    or, after a standstill, from the measured one.

    Args:
        laws: of the arm.
        now: commanded motion of the joints.
    """

    def __init__(self, laws: Laws, now: Reference) -> None:
        self._names = laws.controller.kinematics.joint_names
        self._joints = smooth_joints(laws.controller.kinematics, laws.config, margin=0.0)
        self._joints.begin(now)
        self._led = np.ones(len(now.q), dtype=bool)  # joints that follow the reference

    @property
    def over(self) -> bool:
        """Whether all joints can move, and rest."""
        return bool(self._led.all()) and not self._joints.moving

    @property
    def reference(self) -> Reference:
        """Commanded positions of the joints, at rest."""
        return Reference.at_rest(self._joints.now.q)

    @property
    def words(self) -> str:
        """Reason of the wait, as text."""
        held = [name for name, led in zip(self._names, self._led, strict=True) if not led]
        return f"waits for power and brakes of {', '.join(held)}" if held else "comes to rest"

    def instruct(self, q: FloatArray, v: FloatArray | None, movable: Flags) -> Instruction:
        """Return the joint targets of this motion period.

        Args:
            q: measured angles of the links (N,) [rad or m].
            v: their measured speeds (N,); None: not measured.
            movable: which joints can move (N,).
        """
        now, on = self._joints.now, movable & self._led
        moves = np.zeros_like(q) if v is None else v
        self._joints.begin(
            Reference(np.where(on, now.q, q), np.where(on, now.v, moves), np.where(on, now.a, 0.0))
        )
        self._led = movable
        now = self._joints.now
        return Instruction(now.q, self._joints.halt(), None, now)
