"""Guard against collisions: the joints can always stop before two parts touch."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from arm_emulator.base.refusal import Refusal
from arm_emulator.motion.collisions import Collisions
from arm_emulator.motion.instruction import FloatArray
from arm_emulator.motion.kinematics import Kinematics
from arm_emulator.motion.motion_config import MotionConfig
from arm_emulator.motion.reference import Reference
from arm_emulator.motion.smooth_joints import SmoothJoints

_BETWEEN = 0.05  # m that a part may move between two configurations that are tested
_ROUNDING = 1e-6  # m
_MOST = 2000  # configurations of a way


class WouldTouch(Refusal):
    """Raised for a motion on which parts would touch."""


class CollisionGuard:
    """Tests the reference ahead.

    In each period it tests the way on which the joints would come to rest if they braked after it.
    When parts touch there they brake now, on the way that the period before has tested. So they
    rest before they touch, by the margin, whatever was asked for. Motions that are known to their
    end are checked before they begin.

    Args:
        kinematics: of the arm.
        config: obstacles and margin.

    Raises:
        Refusal: see `Collisions`.
    """

    def __init__(self, kinematics: Kinematics, config: MotionConfig) -> None:
        self._reach = kinematics.reach
        self._scale, self._margin = kinematics.joint_scale, config.collision_margin
        self._kinematics = kinematics
        self.collisions = Collisions(
            kinematics.urdf_xml, kinematics.joint_names, config.obstacles, config.collision_margin
        )
        self._rested: FloatArray | None = None  # a state at rest without contact

    def ahead(self, joints: SmoothJoints, now: FloatArray, then: Reference) -> str:
        """Return which parts touch where the joints stop if they brake from `then` on; empty: none.

        Where parts touch at `now` (N,) already a motion that leads no nearer is let go.
        """
        way = joints.stopping_way(then, self._step)
        if len(way) == 1 and self._rested is not None and np.array_equal(way[0], self._rested):
            return ""
        for q in way[::-1]:
            if touching := self.collisions.fresh(q, now, _ROUNDING):
                return touching
        self._rested = way[0] if len(way) == 1 else None
        return ""

    def along(self, at: Callable[[float], FloatArray], duration: float) -> tuple[float, str] | None:
        """Return when parts touch first on a way, and which; None: they do not.

        Args:
            at: angles (N,) at a time since its begin [s].
            duration: of the way [s].
        """
        time, q = 0.0, at(0.0)
        begin = q  # parts that touch there may move apart: `ahead` watches them
        step = max(duration / 20.0, 1e-6)
        for _ in range(_MOST):
            if time >= duration:
                return None
            ahead = min(duration, time + step)
            coming = at(ahead)
            parts = self._parts(coming - q)
            if parts > 1.0 and step > 1e-4:
                step *= 0.5
                continue
            if touching := self.collisions.fresh(coming, begin, math.inf):
                return ahead, touching
            time, q = ahead, coming
            step *= 1.5 if parts < 0.5 else 1.0
        return None

    def check(self, where: str, at: Callable[[float], FloatArray], duration: float) -> None:
        """Check a whole motion before it begins.

        Args:
            where: names the motion.
            at: angles (N,) at a time since its begin [s].
            duration: of the motion [s].

        Raises:
            WouldTouch: with the pair and the place.
        """
        found = self.along(at, duration)
        if found is None:
            return
        time, touching = found
        place = np.array2string(
            self._kinematics.forward(at(time))[1], precision=3, suppress_small=True
        )
        part = time / duration if duration > 0.0 else 1.0
        got = f"{touching} would touch at {part:.0%} of it, the tool at {place} m"
        raise WouldTouch(where, "the way", f"keep parts {self._margin * 1e3:g} mm apart", got)

    def _step(self, way: FloatArray) -> int:
        """Return the number of pieces in which a way of the joints (N,) is tested."""
        return max(1, math.ceil(self._parts(way)))

    def _parts(self, way: FloatArray) -> float:
        return float(np.abs(way / self._scale).sum()) * self._reach / _BETWEEN
