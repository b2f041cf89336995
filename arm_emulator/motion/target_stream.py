"""Tool targets that come many times a second, as one motion.

The last of them are taken as points of a parabola in time, for the place and for the turn: so the
motion is known where it is now, and where it will be when the next period ends. A mean speed of the
past would lag every curve by the time over which it is a mean.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin

from arm_emulator.motion.instruction import FloatArray
from arm_emulator.motion.kinematics import POSE_ROWS, POSITION_ROWS
from arm_emulator.motion.pose import Pose

GAP = 0.1  # s: targets farther apart in time are no stream
LEAST = 3  # targets in a row
FASTEST, FASTEST_TURN = 2.0, 6.0  # m/s, rad/s: targets farther apart than that are no motion
MEMORY, PERIODS, KEPT = 0.06, 1.6, 4  # s, motion periods and targets that make the motion, at least
_SECONDS = 1e-9


@dataclass(frozen=True, eq=False)
class StreamMotion:
    """Motion of a stream's target since its newest one.

    Attributes:
        time_ns: logical time of the newest target [ns].
        pose: of it.
        terms: place, speed and acceleration from there on, each translation and rotation
            (3, 6) [m, rad, s].
    """

    time_ns: int
    pose: Pose
    terms: FloatArray

    def age(self, now_ns: int) -> float:
        """Return the time since the newest target [s]."""
        return (now_ns - self.time_ns) * _SECONDS

    def at(self, age: float) -> tuple[Pose, FloatArray, FloatArray]:
        """Return pose, speed and acceleration (6,) at an age [m, rad, s]."""
        place, speed, acceleration = self.terms
        move = place + age * speed + 0.5 * age**2 * acceleration
        pose = Pose.computed(
            self.pose.p_WT + move[:POSITION_ROWS],
            pin.exp3(move[POSITION_ROWS:]) @ self.pose.R_WT,
        )
        return pose, speed + age * acceleration, acceleration


@dataclass(eq=False)
class TargetStream:
    """Targets that may be a stream.

    Args:
        period: motion period [s], for which the motion is foretold.

    Attributes:
        posture: joint angles at the first of them, which redundant joints come back to (N,).
    """

    period: float
    posture: FloatArray = field(default_factory=lambda: np.zeros(0))
    _seen: list[tuple[int, Pose]] = field(default_factory=list)
    _count: int = 0

    def take(self, time_ns: int, pose: Pose, q: FloatArray) -> None:
        """Take the newest target.

        Args:
            time_ns: logical time at which it begins to hold [ns].
            pose: of it.
            q: where the joints are commanded to be (N,).
        """
        last = self._seen[-1] if self._seen else (time_ns, pose)
        since = (time_ns - last[0]) * _SECONDS
        if not 0.0 < since <= GAP or not _slow(_between(last[1], pose) / since):
            self._seen, self._count, self.posture = [], 0, q
        self._seen.append((time_ns, pose))
        self._count += 1
        memory = max(MEMORY, PERIODS * self.period)
        while len(self._seen) > KEPT and (time_ns - self._seen[1][0]) * _SECONDS > memory:
            del self._seen[0]

    def motion(self) -> StreamMotion | None:
        """Return the motion of which the newest target is a point; None: it is a single one."""
        if self._count < LEAST:
            return None
        time_ns, newest = self._seen[-1]
        t = np.array([(then - time_ns) * _SECONDS for then, _ in self._seen])
        moves = np.empty((len(t), POSE_ROWS))
        moves[:, :POSITION_ROWS] = np.array([pose.p_WT for _, pose in self._seen]) - newest.p_WT
        moves[:, POSITION_ROWS:] = _turns(
            np.array([pose.R_WT for _, pose in self._seen]) @ newest.R_WT.T
        )
        span = -t[0]
        powers = np.stack([np.ones_like(t), t / span, 0.5 * (t / span) ** 2], axis=1)
        terms = np.linalg.lstsq(powers, moves, rcond=None)[0]
        return StreamMotion(time_ns, newest, terms / span ** np.arange(3)[:, None])


def _slow(twist: FloatArray) -> bool:
    move, turn = twist[:POSITION_ROWS], twist[POSITION_ROWS:]
    return bool(move @ move <= FASTEST**2 and turn @ turn <= FASTEST_TURN**2)


def _turns(R: FloatArray) -> FloatArray:
    """Return the rotation vectors of rotations (K, 3, 3) below half a turn, (K, 3) [rad]."""
    across = 0.5 * np.stack([R[:, i, j] - R[:, j, i] for i, j in ((2, 1), (0, 2), (1, 0))], axis=1)
    sines = np.linalg.norm(across, axis=1, keepdims=True)
    cosines = 0.5 * (np.trace(R, axis1=1, axis2=2)[:, None] - 1.0)
    turns: FloatArray = across * np.arctan2(sines, cosines) / np.maximum(sines, 1e-300)
    return turns


def _between(before: Pose, after: Pose) -> FloatArray:
    both = np.empty(POSE_ROWS)
    both[:POSITION_ROWS] = after.p_WT - before.p_WT
    both[POSITION_ROWS:] = pin.log3(after.R_WT @ before.R_WT.T)
    return both
