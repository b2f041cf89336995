"""Motion by jog commands, until no more arrive."""

from dataclasses import replace
from typing import Self

import numpy as np
import pinocchio as pin

from arm_emulator.base.arrays import Array
from arm_emulator.motion.executor.controllers import Controllers, make_jerk_limited_velocity
from arm_emulator.motion.executor.goal_status import MOVING, GoalProgress, GoalState, Kind
from arm_emulator.motion.executor.goals import Goal
from arm_emulator.motion.executor.jog import JogCommand, JogStatus
from arm_emulator.motion.executor.tool_directions import Speeds, ToolDirections
from arm_emulator.motion.model.joint_reference import JointSetpoint, Reference
from arm_emulator.motion.model.kinematics import POSE_ROWS, POSITION_ROWS, Kinematics
from arm_emulator.motion.model.pose import Pose
from arm_emulator.motion.planner.target_planner import ACCELERATION_SHARE


class JogGoal(Goal):
    """Follows the newest jog command, and comes to rest when it is too old.

    Attributes:
        command: the newest.
        status: limit of the motion.
        words: the same as text.
    """

    kind = Kind.JOG

    def __init__(self, command: JogCommand) -> None:
        self.command = command
        self.status, self.words = JogStatus.NO_WARNING, ""

    @classmethod
    def make_stop(cls, now_ns: int, joints: int) -> Self:
        """Return the order to come to rest from now on."""
        return cls(JogCommand(now_ns, None, "", np.zeros(joints)))

    def begin_motion(self, controllers: Controllers, now_ns: int, reference: Reference) -> None:
        """See `Goal`."""
        margin = controllers.config.jog_joint_limit_margin
        self._joints = make_jerk_limited_velocity(
            controllers.controller.kinematics, controllers.config, margin, ACCELERATION_SHARE
        )
        self._joints.take_over(reference)
        self._line = JogLine(controllers.controller.kinematics)
        self._stale = False
        controllers.leading = None

    def compute_setpoint(self, controllers: Controllers, now_ns: int, q: Array) -> JointSetpoint:
        """See `Goal`."""
        now, config, command = self._joints.now, controllers.config, self.command
        timeout = round(config.jog_incoming_command_timeout * 1e9)
        self._stale = now_ns - command.time_ns > timeout
        speeds = Speeds(np.zeros_like(now.q))
        if self._stale or command.twist is None:
            self._line.forget_line()
        if not self._stale:
            speeds = self._compute_speeds(controllers, now)
        self.status, self.words = speeds.status, speeds.status.words
        v = self._limit_speeds(controllers, now.q, speeds.v)
        mean = self._joints.advance_towards(v, alone=command.joints is not None)
        guard = controllers.guard
        if guard and (touching := guard.check_ahead(self._joints, now.q, self._joints.now)):
            self.status, self.words = JogStatus.HALT_FOR_COLLISION, f"{touching} would touch"
            self._joints.take_over(now)
            mean = self._joints.stop_joints()
        return JointSetpoint(now.q, mean, None, now)

    def _compute_speeds(self, controllers: Controllers, now: Reference) -> Speeds:
        command = self.command
        if command.joints is not None:
            return Speeds(command.joints)
        assert command.twist is not None
        kinematics = controllers.controller.kinematics
        # Speeds taken up in this period hold at its end.
        coming = now.q + controllers.config.period * now.v
        twist = command.twist
        if command.link:
            R_WL = kinematics.axes(command.link, coming)
            twist = np.concatenate([R_WL @ twist[:3], R_WL @ twist[3:]])
        here = ToolDirections(kinematics, coming)
        speeds = here.compute_speeds(twist, controllers.config, self._joints.limit_brake_share)
        if speeds.status is not JogStatus.NO_WARNING:
            self._line.forget_line()  # what leads back may be what is lost there
            return speeds
        back = self._line.compute_return(coming, now.v, command.twist, twist)
        return replace(speeds, v=speeds.v + here.compute_speeds(back, controllers.config).v)

    def _limit_speeds(self, controllers: Controllers, q: Array, v: Array) -> Array:
        """Return the permitted speeds: a tool keeps its direction, joints are limited singly."""
        allowed = self._joints.limit_shares(q, v)
        slowed = [
            controllers.controller.kinematics.joint_names[j] for j in np.flatnonzero(allowed < 1.0)
        ]
        if slowed:
            self.status = JogStatus.JOINT_BOUND
            self.words = f"{self.status.words}: {', '.join(slowed)}"
        return v * (allowed if self.command.joints is not None else allowed.min())

    def evaluate_reference(self, now_ns: int) -> Reference | None:
        """See `Goal`."""
        return self._joints.now

    def compute_progress(self, now_ns: int, q: Array, v: Array | None) -> GoalProgress:
        """See `Goal`."""
        if self._stale and not self._joints.is_moving:
            return GoalProgress(GoalState.REACHED, "no command any more, at rest")
        return MOVING


# Joint speeds that grow together lead a tool aside while they grow, and a twist alone has no place
# to come back to. The line begins where the tool rests, or where it goes along the twist. It shifts
# with the tool along the twist: how far the tool has come is the lever's business.
GAIN = 15.0  # 1/s, of the distance from the line
MAX_SHARE = 0.3  # of the twist, that leads back at most
_SAME = 0.9998  # cosine: 1 degree
_ALONG = 0.02  # of the twist, that may lead aside where a line begins


class JogLine:
    """The line of one arm's jog."""

    def __init__(self, kinematics: Kinematics) -> None:
        self._kinematics = kinematics
        self._command: Array = np.zeros(POSE_ROWS)
        self._place: Pose | None = None

    def forget_line(self) -> None:
        """Forget the line."""
        self._place = None

    def compute_return(self, q: Array, v: Array, command: Array, twist: Array) -> Array:
        """Return the twist that leads the tool back to its line (6,) [m/s, rad/s].

        `command` is the commanded twist in its own frame, `twist` the same along the world's axes.
        """
        kinematics, rows = self._kinematics, self._kinematics.rows
        scale, back = kinematics.scale, np.zeros(POSE_ROWS)
        scaled_twist = scale * twist[:rows]
        size = float(np.linalg.norm(scaled_twist))
        if size == 0.0 or not self._is_same_direction(command):
            self.forget_line()
        self._command = command
        if size == 0.0:
            return back
        if self._place is None:
            tool = scale * (kinematics.jacobian(q) @ v)
            if np.linalg.norm(_remove_along(tool, scaled_twist)) <= _ALONG * size:
                R_WT, p_WT = kinematics.forward(q)
                self._place = Pose(p_WT, R_WT)
            return back
        off = scale * kinematics.tool_error(q, self._place)
        passed = -float(off @ scaled_twist) / size**2
        self._place = Pose(
            self._place.p_WT + passed * twist[:POSITION_ROWS],
            pin.exp3(passed * twist[POSITION_ROWS:]) @ self._place.R_WT,
        )
        aside = GAIN * _remove_along(off, scaled_twist)
        much = float(np.linalg.norm(aside)) / (MAX_SHARE * size)
        back[:rows] = aside / scale / max(1.0, much)
        return back

    def _is_same_direction(self, command: Array) -> bool:
        norms = float(np.linalg.norm(command) * np.linalg.norm(self._command))
        return float(command @ self._command) >= _SAME * norms > 0.0


def _remove_along(vector: Array, along: Array) -> Array:
    """Return the part of a vector across another."""
    across: Array = vector - along * float(vector @ along) / float(along @ along)
    return across
