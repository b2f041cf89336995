"""Tool targets that come many times a second: each is a moment of a motion, not an end of one.

Between two targets of a stream the tool goes on with the speed that their difference makes, so that
it does not lag the stream by what it would need to come to rest. When no more targets come the last
one is where it comes to rest.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from arm_emulator.motion.instruction import FloatArray, Instruction
from arm_emulator.motion.jog import speeds_of_twist
from arm_emulator.motion.joint_goal import directions
from arm_emulator.motion.kinematics import POSE_ROWS, Kinematics
from arm_emulator.motion.laws import Laws, smooth_joints
from arm_emulator.motion.motion_report import Kind
from arm_emulator.motion.orders import MOVING, Progress, TargetOrder
from arm_emulator.motion.pose import Pose
from arm_emulator.motion.reference import Reference

GAP = 0.1  # s: targets farther apart in time are no stream
LEAST = 3  # targets in a row
FASTEST, FASTEST_TURN = 2.0, 6.0  # m/s, rad/s: targets farther apart than that are no motion
NEAR, NEAR_TURN = 0.1, 0.5  # m, rad: a tool farther from its target goes there by a way of its own
GAIN = 15.0  # 1/s, of the tool's distance
BACK = 2.0  # 1/s, of redundant joints' distance from their posture
SMOOTH = 0.5  # part of a newly measured speed that counts
_SECONDS = 1e-9


@dataclass(frozen=True, eq=False)
class _Seen:
    time_ns: int
    pose: Pose
    twist: FloatArray
    """Between this target and those before (6,) [m/s, rad/s]."""
    count: int
    """Number of successive targets."""
    posture: FloatArray
    """Joint angles at the first of them, which redundant joints come back to (N,) [rad or m]."""


class TargetStream:
    """Detects a stream of targets."""

    def __init__(self) -> None:
        self._last: _Seen | None = None

    def following(
        self, order: TargetOrder, now_ns: int, kinematics: Kinematics, q: FloatArray
    ) -> TargetOrder | StreamOrder:
        """Return the order for a target that begins to hold: itself, or that of a stream.

        Args:
            order: of the target.
            now_ns: logical time [ns].
            kinematics: of the arm.
            q: where the joints are commanded to be (N,).
        """
        pose, last = order.pose, self._last
        self._last = _Seen(now_ns, pose, np.zeros(POSE_ROWS), 1, q)
        if last is None or not 0.0 < (now_ns - last.time_ns) * _SECONDS <= GAP:
            return order
        twist = _between(last.pose, pose) / ((now_ns - last.time_ns) * _SECONDS)
        if np.linalg.norm(twist[:3]) > FASTEST or np.linalg.norm(twist[3:]) > FASTEST_TURN:
            return order
        twist = twist if last.count == 1 else SMOOTH * twist + (1.0 - SMOOTH) * last.twist
        posture = last.posture
        self._last = _Seen(now_ns, pose, twist, last.count + 1, posture)
        error = kinematics.tool_error(q, pose)
        far = np.linalg.norm(error[:3]) > NEAR or np.linalg.norm(error[3:]) > NEAR_TURN
        return (
            order if far or last.count + 1 < LEAST else StreamOrder(order, now_ns, twist, posture)
        )


class StreamOrder:
    """Follows the newest target of a stream, which moves with a speed.

    Args:
        target: the order to rest at the target.
        time_ns: when the target held [ns].
        twist: its speed (6,) [m/s, rad/s].
        posture: joint angles that redundant joints come back to (N,) [rad or m].
    """

    kind = Kind.TOOL_TARGET
    way = ""

    def __init__(
        self, target: TargetOrder, time_ns: int, twist: FloatArray, posture: FloatArray
    ) -> None:
        self.stamp_ns, self._posture = target.stamp_ns, posture
        self._target, self._time_ns, self._twist = target, time_ns, twist

    def begin(self, laws: Laws, now_ns: int, reference: Reference) -> None:
        """See `Order`."""
        self._joints = smooth_joints(laws.controller.kinematics, laws.config, margin=0.0)
        self._joints.begin(reference)
        self._rests = False
        laws.nobody_leads()

    def go_on(self, laws: Laws, now_ns: int, reference: Reference) -> None:
        """See `Order`."""
        self.begin(laws, now_ns, reference)

    def instruct(self, laws: Laws, now_ns: int, q: FloatArray) -> Instruction:
        """See `Order`."""
        age = (now_ns - self._time_ns) * _SECONDS
        if not self._rests and age > GAP:
            self._rests = True
            self._target.begin(laws, now_ns, self._joints.now)
        if self._rests:
            return self._target.instruct(laws, now_ns, q)
        kinematics, now = laws.controller.kinematics, self._joints.now
        coming = now.q + laws.config.period * now.v
        error = np.zeros(POSE_ROWS)
        error[: kinematics.rows] = kinematics.tool_error(now.q, self._at(age))
        v = speeds_of_twist(kinematics, coming, self._twist + GAIN * error, laws.config).v
        v = v + self._back(kinematics, coming)
        mean = self._joints.go(v * self._joints.allowed(now.q, v).min(), alone=False)
        return Instruction(now.q, mean, None, now)

    def _back(self, kinematics: Kinematics, q: FloatArray) -> FloatArray:
        """Return the joint speeds towards the posture that do not move the tool (N,)."""
        if len(q) <= kinematics.rows:
            return np.zeros_like(q)
        scale = kinematics.joint_scale
        idle = directions(kinematics.scale[:, None] * kinematics.jacobian(q) * scale)[1]
        idle = idle[:, : len(q) - kinematics.rows]
        return np.asarray(scale * (idle @ (idle.T @ ((self._posture - q) / scale))) * BACK)

    def _at(self, age: float) -> Pose:
        """Return the target's present pose."""
        pose, move = self._target.pose, age * self._twist
        return Pose(pose.p_WT + move[:3], pin.exp3(move[3:]) @ pose.R_WT)

    def reference(self, now_ns: int) -> Reference | None:
        """See `Order`."""
        return self._target.reference(now_ns) if self._rests else self._joints.now

    def progress(self, now_ns: int, q: FloatArray, v: FloatArray | None) -> Progress:
        """See `Order`."""
        return self._target.progress(now_ns, q, v) if self._rests else MOVING


def _between(before: Pose, after: Pose) -> FloatArray:
    turn = pin.log3(after.R_WT @ before.R_WT.T)
    both: FloatArray = np.concatenate([after.p_WT - before.p_WT, turn])
    return both
