"""Tolerances of joint trajectories, on the way and at the end."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from arm_emulator.base.arrays import Array
from arm_emulator.base.refusal import Refusal
from arm_emulator.base.validation.joint_order import check_joints_exist

WHERE = "joint_trajectory"


@dataclass(frozen=True, eq=False)
class Allowed:
    """Largest errors, (N,) each; 0 allows any error."""

    q: Array
    """[rad]."""
    v: Array
    """[rad/s]."""

    @classmethod
    def make_equal(cls, count: int, q: float) -> Allowed:
        """Return the same angle for all joints, and any speed."""
        return cls(np.full(count, q), np.zeros(count))

    def describe_excess(self, names: Sequence[str], q: Array, v: Array | None) -> str:
        """Return as text the joint whose error is larger; empty: none.

        Args:
            names: of the joints.
            q: errors of the angles [rad].
            v: errors of the speeds [rad/s]; None: not known.
        """
        for error, largest, unit in ((q, self.q, "rad"), (v, self.v, "rad/s")):
            if error is None:
                continue
            for j in np.flatnonzero((largest > 0.0) & ~(np.abs(error) <= largest)).tolist():
                return (
                    f"{names[j]} is off by {abs(error[j]):.3g} {unit}, more than {largest[j]:.3g}"
                )
        return ""

    def change_values(
        self, names: Sequence[str], values_by_joint: Mapping[str, tuple[float, float]]
    ) -> Allowed:
        """Return what control_msgs/JointTolerance makes of it: 0 keeps a value, -1 means any."""
        q, v = self.q.copy(), self.v.copy()
        check_joints_exist(WHERE, values_by_joint, names)
        for name, values in values_by_joint.items():
            for table, value, unit in ((q, values[0], "rad"), (v, values[1], "rad/s")):
                if not (value >= 0.0 or value == -1.0):
                    rule = f"be >= 0 {unit}, or -1 for any"
                    raise Refusal(WHERE, f"tolerance of {name}", rule, value)
                if value:
                    table[names.index(name)] = max(0.0, value)
        return Allowed(q, v)


@dataclass(frozen=True, eq=False)
class Tolerances:
    """Tolerances along a trajectory, and at its end."""

    path: Allowed
    goal: Allowed
    goal_time: float = 0.0
    """Time after its end in which the joints must come within `goal` [s]; 0: unlimited."""
