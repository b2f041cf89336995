"""Search for another configuration of the arm that reaches a target."""

import math

import numpy as np

from arm_emulator.base.arrays import Array
from arm_emulator.motion.ik.inverse_kinematics import InverseKinematics
from arm_emulator.motion.model.kinematics import Kinematics
from arm_emulator.motion.model.pose import Pose

STARTS = 32
_STEPS = 40  # from each


class ConfigurationSearch:
    """Steps of an `InverseKinematics` from joint angles all over the limits, those nearest to the
    arm first.

    Before these, joints that stand at a limit are tried a turn farther back.

    The angles are evenly spread and the same for every target. Joints that turn farther than half a
    turn either way begin within half a turn of where they are. Joints that do not move the tool
    stay.
    """

    def __init__(self, kinematics: Kinematics) -> None:
        self._to_tool = kinematics.to_tool
        self._goal = InverseKinematics(kinematics.of_tool)
        self._parts = generate_low_discrepancy(STARTS, int(self._to_tool.sum()))
        self._starts: list[Array] = []

    def begin_search(self, target: Pose, q: Array) -> None:
        """Look for a configuration for another target, the arm being at q (N,)."""
        kinematics = self._goal.kinematics
        self._all, q = q, q[self._to_tool]
        turn = math.pi * kinematics.joint_scale
        low = np.maximum(kinematics.lower, np.minimum(q, kinematics.upper) - turn)
        high = np.minimum(kinematics.upper, np.maximum(q, kinematics.lower) + turn)
        starts = low + self._parts * (high - low)
        far = np.linalg.norm((starts - q) / kinematics.joint_scale, axis=1)
        self._starts = self._turn_back(q) + list(starts[np.argsort(far, kind="stable")])
        self._target = target
        self._begin_next()

    @property
    def is_over(self) -> bool:
        """Whether all angles have been tried."""
        return not self._starts

    def search_steps(self, steps: int) -> Array | None:
        """Take so many steps; return joint angles that reach the target if any are found."""
        if self.is_over:
            return None
        goal = self._goal
        goal.iterate_steps(steps)
        self._left -= steps
        angles = None
        if goal.is_reached:
            angles = self._all.copy()
            angles[self._to_tool] = goal.q
        if angles is not None or goal.settled or self._left <= 0:
            self._starts.pop(0)
            if self._starts:
                self._begin_next()
        return angles

    def _turn_back(self, q: Array) -> list[Array]:
        """Return where joints at a limit are after a turn back: all of them, and each alone."""
        kinematics = self._goal.kinematics
        revolutions = np.where(q >= kinematics.upper, -2.0 * math.pi, 0.0)
        revolutions[q <= kinematics.lower] = 2.0 * math.pi
        revolutions[kinematics.joint_scale != 1.0] = 0.0
        # From the other end of its range a joint can continue, even if that is less than a turn
        # away.
        back = np.minimum(np.maximum(q + revolutions, kinematics.lower), kinematics.upper)
        joints = np.flatnonzero(revolutions)
        alone = [np.where(np.arange(len(q)) == j, back, q) for j in joints]
        return ([back] if len(joints) else []) + (alone if len(joints) > 1 else [])

    def _begin_next(self) -> None:
        self._goal.set_posture(self._starts[0])
        self._goal.set_target(self._target, self._starts[0])
        self._left = _STEPS


def generate_low_discrepancy(count: int, dimensions: int) -> Array:
    """Return points (count, dimensions) in [0, 1).

    They are an additive sequence with the powers of the generalised golden ratio (Roberts 2018, The
    unreasonable effectiveness of quasirandom sequences).
    """
    ratio = 2.0
    for _ in range(64):  # the root of x^(n+1) = x + 1
        ratio = (1.0 + ratio) ** (1.0 / (dimensions + 1))
    powers = ratio ** -np.arange(1.0, dimensions + 1.0)
    return np.asarray(np.mod(0.5 + np.outer(np.arange(1.0, count + 1.0), powers), 1.0))
