"""Check that the measured tool keeps to its path, and passes all of its poses."""

from collections import deque
from collections.abc import Sequence

import numpy as np

from arm_emulator.base.arrays import Array
from arm_emulator.motion.model.kinematics import Kinematics
from arm_emulator.motion.model.pose import Pose

_LATE = 100  # motion periods by which the tool may be behind its reference


class PathMonitor:
    """Compares the measured tool with the way of the reference, not with its place on it.

    A late tool is still on its path. With a tolerance of 0 it may be anywhere.

    Attributes:
        broken: deviation of the tool from its path, as text; empty: none.
    """

    def __init__(self, kinematics: Kinematics, poses: Sequence[Pose], tolerance: float) -> None:
        self._kinematics, self._tolerance = kinematics, tolerance
        self._poses = np.array([pose.p_WT for pose in poses])
        self._path_points: deque[Array] = deque(maxlen=_LATE)
        self._before: Array | None = None
        self._passed = np.full(len(poses), np.inf)  # by the reference
        self._reached = np.full(len(poses), np.inf)  # by the measured tool
        self.broken = ""

    def observe_angles(self, q_reference: Array, q: Array) -> None:
        """Take reference and measured joint angles of a motion period, (N,) each."""
        expected = self._kinematics.forward(q_reference)[1]
        tool = self._kinematics.forward(q)[1]
        if self._path_points:
            passed = measure_distances(self._poses, self._path_points[-1][None], expected[None])[
                :, 0
            ]
            self._passed = np.minimum(self._passed, passed)
        if self._before is not None:
            reached = measure_distances(self._poses, self._before[None], tool[None])[:, 0]
            self._reached = np.minimum(self._reached, reached)
        self._before = tool
        self._path_points.append(expected)
        path = np.array(self._path_points)
        off = float(
            measure_distances(tool[None], path[:-1], path[1:]).min(
                initial=np.linalg.norm(tool - expected)
            )
        )
        if 0.0 < self._tolerance < off and not self.broken:
            self.broken = (
                f"the tool is {off * 1e3:.3g} mm beside its path, "
                f"more than {self._tolerance * 1e3:.3g} mm"
            )

    @property
    def missed(self) -> str:
        """First pose that the tool has not passed, as text; empty: it has passed all."""
        was_passed = np.isfinite(self._passed)
        off = np.where(was_passed, self._reached, 0.0) - np.where(was_passed, self._passed, 0.0)
        if self._tolerance == 0.0 or not (off > self._tolerance).any():
            return ""
        k = int(np.argmax(off))
        return f"poses[{k}] was missed by {off[k] * 1e3:.3g} mm"


def measure_distances(points: Array, begins: Array, ends: Array) -> Array:
    """Return the distances of points (P, 3) from segments (S, 3), (P, S) [m]."""
    along = ends - begins
    to = points[:, None] - begins
    square = np.maximum((along * along).sum(axis=1), 1e-300)
    part = np.clip((to * along).sum(axis=2) / square, 0.0, 1.0)
    return np.asarray(np.linalg.norm(to - part[..., None] * along, axis=2))
