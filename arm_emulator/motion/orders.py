"""What an arm is commanded, while it does it: hold its tool, follow its joints, or a path."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import pinocchio as pin

from arm_emulator.motion.controller import Controller
from arm_emulator.motion.instruction import FloatArray, Instruction
from arm_emulator.motion.joint_trajectory import JointMotion, JointTrajectory
from arm_emulator.motion.kinematics import POSE_ROWS, POSITION_ROWS
from arm_emulator.motion.laws import Laws
from arm_emulator.motion.motion_config import MotionConfig
from arm_emulator.motion.motion_report import Kind, State
from arm_emulator.motion.pose import Pose
from arm_emulator.motion.reference import Reference
from arm_emulator.motion.tolerances import Tolerances
from arm_emulator.motion.tool_path import ToolMotion, ToolPath, ToolState

PATIENCE = 1.0  # s: an error that has not become smaller for so long will not
_SMALLER = 0.99  # what counts as smaller
_AT_REST = 1e-3  # rad/s

# With what the reasons begin why a trajectory was aborted.
PATH_TOLERANCE = "path tolerance"
GOAL_TOLERANCE = "goal tolerance"

_SECONDS = 1e-9


@dataclass(frozen=True)
class Progress:
    """How far an order is."""

    state: State
    reason: str = ""
    distance: float = math.nan
    """From the tool to where it shall be in the end [m]."""
    angle: float = math.nan
    """The same of its orientation [rad]."""


MOVING = Progress(State.MOVING)


class Order(Protocol):
    """What every order offers.

    Attributes:
        kind: what it came as.
        stamp_ns: logical time from which it holds [ns]; 0: at once.
    """

    kind: Kind
    stamp_ns: int

    def begin(self, laws: Laws, now_ns: int, reference: Reference) -> None:
        """Take over from `reference`.

        Raises:
            Refusal: it cannot be begun so. Nothing has changed then.
        """

    def instruct(self, laws: Laws, now_ns: int, q: FloatArray) -> Instruction:
        """Return the joint targets of this motion period."""

    def reference(self, now_ns: int) -> Reference | None:
        """Return how the joints are commanded to move; None: as the last instruction was."""

    def progress(self, now_ns: int, q: FloatArray, v: FloatArray | None) -> Progress:
        """Return how far it is, after `instruct`, by the measured angles and speeds."""


class TargetOrder:
    """The tool shall be in a pose."""

    kind = Kind.TOOL_TARGET

    def __init__(self, stamp_ns: int, pose: Pose) -> None:
        self.stamp_ns, self.pose = stamp_ns, pose

    def begin(self, laws: Laws, now_ns: int, reference: Reference) -> None:
        """See `Order`."""
        laws.lead(laws.controller, reference.q, reference.v)
        self._law, self._arrival = laws.controller, _Arrival(laws.config)

    def instruct(self, laws: Laws, now_ns: int, q: FloatArray) -> Instruction:
        """See `Order`."""
        self._instruction = self._law.update(q, self.pose)
        return self._instruction

    def reference(self, now_ns: int) -> Reference | None:
        """See `Order`."""
        return None

    def progress(self, now_ns: int, q: FloatArray, v: FloatArray | None) -> Progress:
        """See `Order`."""
        return self._arrival.progress(now_ns, self._law, self._instruction)


class PathOrder:
    """The tool shall go along a path."""

    kind = Kind.TOOL_PATH

    def __init__(self, path: ToolPath) -> None:
        self.stamp_ns, self._path = path.stamp_ns, path

    def begin(self, laws: Laws, now_ns: int, reference: Reference) -> None:
        """See `Order`."""
        kinematics = laws.follower.kinematics
        R_WT, p_WT = kinematics.forward(reference.q)
        twist = np.zeros(POSE_ROWS)
        twist[: kinematics.rows] = kinematics.jacobian(reference.q) @ reference.v
        whole = kinematics.rows == POSE_ROWS
        pose = Pose(p_WT, R_WT if whole else self._path.first.R_WT)
        state = ToolState(pose, twist[:POSITION_ROWS], twist[POSITION_ROWS:])
        self._motion: ToolMotion = self._path.begin(now_ns, state)
        laws.lead(laws.follower, reference.q, reference.v)
        self._law, self._arrival = laws.follower, _Arrival(laws.config)

    def instruct(self, laws: Laws, now_ns: int, q: FloatArray) -> Instruction:
        """See `Order`."""
        now, then = (self._motion.sample(now_ns + t).pose for t in (0, laws.period_ns))
        turn = pin.log3(then.R_WT @ now.R_WT.T)
        twist = np.concatenate([then.p_WT - now.p_WT, turn]) / (laws.period_ns * _SECONDS)
        self._instruction = laws.follower.follow(q, now, twist)
        return self._instruction

    def reference(self, now_ns: int) -> Reference | None:
        """See `Order`."""
        return None

    def progress(self, now_ns: int, q: FloatArray, v: FloatArray | None) -> Progress:
        """See `Order`."""
        if now_ns < self._motion.end_ns:
            return MOVING
        return self._arrival.progress(now_ns, self._law, self._instruction)


class TrajectoryOrder:
    """The joints shall follow a trajectory."""

    kind = Kind.JOINT_TRAJECTORY

    def __init__(self, trajectory: JointTrajectory, tolerances: Tolerances) -> None:
        self.stamp_ns, self.trajectory = trajectory.stamp_ns, trajectory
        self._tolerances = tolerances

    def begin(self, laws: Laws, now_ns: int, reference: Reference) -> None:
        """See `Order`."""
        start_ns = self.stamp_ns or now_ns
        self._motion: JointMotion = self.trajectory.begin(
            now_ns, start_ns, reference.q, reference.v, reference.a
        )
        self._start_ns = start_ns
        laws.nobody_leads()

    def instruct(self, laws: Laws, now_ns: int, q: FloatArray) -> Instruction:
        """See `Order`."""
        now = Reference(*self._motion.sample(now_ns))
        then = self._motion.sample(now_ns + laws.period_ns)[0]
        effort = None
        if not self.trajectory.stops:
            effort = self.trajectory.effort(now_ns, self._start_ns)
        return Instruction(now.q, (then - now.q) / (laws.period_ns * _SECONDS), effort, now)

    def reference(self, now_ns: int) -> Reference | None:
        """See `Order`."""
        return Reference(*self._motion.sample(now_ns))

    def progress(self, now_ns: int, q: FloatArray, v: FloatArray | None) -> Progress:
        """See `Order`."""
        q_ref, v_ref, _ = self._motion.sample(now_ns)
        v_error = None if v is None else v_ref - v
        names = self.trajectory.joint_names
        late = (now_ns - self._motion.end_ns) * _SECONDS
        if late < 0.0:
            broken = self._tolerances.path.broken(names, q_ref - q, v_error)
            return Progress(State.ABORTED, f"{PATH_TOLERANCE}: {broken}") if broken else MOVING
        broken = self._tolerances.goal.broken(names, q_ref - q, v_error)
        if not broken:
            return Progress(State.REACHED)
        if 0.0 < self._tolerances.goal_time < late:
            return Progress(State.ABORTED, f"{GOAL_TOLERANCE} after {late:.3g} s: {broken}")
        return MOVING


class _Arrival:
    """Judges by the tool's error whether a tool has arrived, or comes no nearer."""

    def __init__(self, config: MotionConfig) -> None:
        self._config = config
        self._best = math.inf
        self._best_at = 0

    def progress(self, now_ns: int, law: Controller, instruction: Instruction) -> Progress:
        config, error = self._config, law.error
        distance = float(np.linalg.norm(error[:POSITION_ROWS]))
        angle = float(np.linalg.norm(error[POSITION_ROWS:])) if len(error) > POSITION_ROWS else 0.0
        size = max(distance / config.reached_within, angle / config.reached_within_angle)
        shown = angle if len(error) > POSITION_ROWS else math.nan
        if size <= 1.0:
            return Progress(State.REACHED, "", distance, shown)
        if size < _SMALLER * self._best:
            self._best, self._best_at = size, now_ns
        at_rest = instruction.v is None or float(np.abs(instruction.v).max()) <= _AT_REST
        if law.searching:
            self._best_at = now_ns
        if at_rest and (now_ns - self._best_at) * _SECONDS >= PATIENCE:
            return Progress(State.UNREACHABLE, "; ".join(law.notices), distance, shown)
        return Progress(State.MOVING, "", distance, shown)
