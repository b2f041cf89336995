"""Following a stream of tool targets: each is a moment of a motion, not an end of one.

The tool goes with the motion that the targets make (`TargetStream`), to where that is at the end of
the motion period, with its speed and acceleration there. When no more targets come the last one is
where it comes to rest.
"""

from __future__ import annotations

import numpy as np

from arm_emulator.motion.instruction import FloatArray, Instruction
from arm_emulator.motion.kinematics import POSE_ROWS, POSITION_ROWS, Kinematics
from arm_emulator.motion.laws import Laws, smooth_joints
from arm_emulator.motion.motion_report import Kind
from arm_emulator.motion.orders import MOVING, Planned, Progress, TargetOrder
from arm_emulator.motion.reference import Reference
from arm_emulator.motion.target_stream import GAP, StreamMotion
from arm_emulator.motion.tool_directions import ToolDirections

NEAR, NEAR_TURN = 0.1, 0.5  # m, rad: a tool farther from its target goes there by a way of its own
GAIN, MOST = 15.0, 0.4  # 1/s, of the tool's distance, and part of it in a period at most
BACK = 2.0  # 1/s, of redundant joints' distance from their posture
_AHEAD = 1e-3  # s, over which the change of joint speeds is taken


def is_near(kinematics: Kinematics, q: FloatArray, target: TargetOrder) -> bool:
    """Return whether a tool is near enough to its target to go on with a stream."""
    error = kinematics.tool_error(q, target.pose)
    move, turn = error[:POSITION_ROWS], error[POSITION_ROWS:]
    return bool(move @ move <= NEAR**2 and turn @ turn <= NEAR_TURN**2)


class StreamOrder:
    """Follows the motion of a stream.

    Args:
        target: the order to rest at its newest target.
        motion: of the stream.
        posture: joint angles that redundant joints come back to (N,) [rad or m].
    """

    kind = Kind.TOOL_TARGET
    way = ""

    def __init__(self, target: TargetOrder, motion: StreamMotion, posture: FloatArray) -> None:
        self.stamp_ns = target.stamp_ns
        self._target, self._motion, self._posture = target, motion, posture

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
        age = self._motion.age(now_ns)
        if not self._rests and age > GAP:
            self._rests = True
            self._target.begin(laws, now_ns, self._joints.now)
        if self._rests:
            return self._target.instruct(laws, now_ns, q)
        kinematics, now = laws.controller.kinematics, self._joints.now
        period = laws.config.period
        coming = now.q + period * (now.v + 0.5 * period * now.a)
        pose, twist, acceleration = self._motion.at(age + period)
        error = np.zeros(POSE_ROWS)
        error[: kinematics.rows] = kinematics.tool_error(coming, pose)
        here = ToolDirections(kinematics, coming)
        leads = here.speeds(twist, laws.config).v
        then = ToolDirections(kinematics, coming + _AHEAD * leads)
        a = (then.speeds(twist + _AHEAD * acceleration, laws.config).v - leads) / _AHEAD
        nearer = twist + min(GAIN, MOST / period) * error
        v = here.speeds(nearer, laws.config, self._joints.brakes).v
        v = v + here.idle(BACK * (self._posture - coming))
        share = self._joints.allowed(now.q, v).min()
        mean = self._joints.go(v * share, alone=False, a=a * share)
        return Instruction(now.q, mean, None, now)

    def reference(self, now_ns: int) -> Reference | None:
        """See `Order`."""
        return self._target.reference(now_ns) if self._rests else self._joints.now

    def planned(self) -> Planned | None:
        """See `Order`."""
        return self._target.planned() if self._rests else None

    def progress(self, now_ns: int, q: FloatArray, v: FloatArray | None) -> Progress:
        """See `Order`."""
        return self._target.progress(now_ns, q, v) if self._rests else MOVING
