"""Joint targets within all limits of the joints: bounded differential inverse kinematics.

In every motion period:

1. `JointGoal` steps on towards the joint angles of the tool's target, or of the reachable point
   nearest to it.
2. The way from the reference there is that line of the joints, bent so that the tool keeps to a
   straight line wherever the Jacobian lets it.
3. The speed along the way is the largest from which every joint can brake.
4. Of all speeds in the box of the limits the nearest to that is taken, nearest as the tool
   sees it: a quadratic program.

The reference (angles and speeds) is the controller's own. It begins at rest where the arm is and
never depends on a measurement later, so that the limits hold by construction, whatever the servo
does, and measurement noise does not come back as motion.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from arm_emulator.motion.box_qp import solve_in_box
from arm_emulator.motion.configuration_search import ConfigurationSearch
from arm_emulator.motion.instruction import Instruction
from arm_emulator.motion.joint_goal import JointGoal, directions
from arm_emulator.motion.kinematics import POSITION_ROWS, Kinematics
from arm_emulator.motion.motion_config import MotionConfig
from arm_emulator.motion.pose import Pose
from arm_emulator.motion.speed_box import SpeedBox

FloatArray = npt.NDArray[np.float64]

STEPS = 3  # of the joint goal per motion period
LOST = 0.2  # rad (or m per reach) between arm and reference: somebody else moves the arm
_BRAKES = 0.7  # part of the acceleration with which a way ends; the rest is for its bends
_NEARER = 0.2  # least part of the way to the joint goal that its bent line must lead nearer
_APPROACH = 0.3  # largest part of the way in one period
_SINGULAR = 0.1  # rad/rad: below, the tool's line is given up for the joints'
_SPEED_SHARE = 0.89  # of the description's limit; the rest is for links that swing on their gears
_SEARCH_TIME = 3e-3  # s of logical time for a step of the search
_REST = 1e-4  # rad: this near to the joint goal the arm is there
_TOOL_WEIGHT = 1e3  # of the tool's deviation against the joints'


class QpController:
    """Tool targets to joint targets with speeds, within position, speed and acceleration limits.

    Args:
        kinematics: of the arm, with its limits.
        period: motion period [s].
        velocity_limit: largest joint speed beside the description's [rad/s or m/s].
        acceleration_limit: largest joint acceleration beside the description's [rad/s2 or m/s2].
    """

    def __init__(
        self,
        kinematics: Kinematics,
        period: float,
        velocity_limit: float = 3.0,
        acceleration_limit: float = 10.0,
    ) -> None:
        self.kinematics = kinematics
        self.period = period
        self._goal = JointGoal(kinematics)
        self._elsewhere = ConfigurationSearch(kinematics)
        self._searching = False
        self._scales = kinematics.scale[:, None] * kinematics.joint_scale
        self._limit(velocity_limit, acceleration_limit)
        self.notices: tuple[str, ...] = ()
        """What limited the last answer, in words; empty: nothing did."""
        self.error = np.full(kinematics.rows, math.nan)
        """Tool error that the last answer found, (rows,) [m, rad]; NaN before any."""
        self._target: Pose | None = None
        self._end_q: FloatArray | None = None
        self._goal_before: FloatArray | None = None
        self._q_measured: FloatArray | None = None
        self._begin(np.zeros(len(kinematics.joint_names)))
        self._began = False

    def retune(self, config: MotionConfig) -> None:
        """Go on with other limits."""
        self._limit(config.velocity_limit, config.acceleration_limit)

    def begin(self, q: npt.ArrayLike, v: npt.ArrayLike | None = None) -> None:
        """Begin at joint angles q (N,), which redundant arms come back to.

        Args:
            q: [rad or m].
            v: joint speeds (N,) [rad/s or m/s]; None: at rest.

        Raises:
            Refusal: q of a wrong length, not finite or too large. Nothing has changed then.
        """
        self._begin(self.kinematics.vector(q))
        if v is not None:
            most = self._velocity
            self._v = np.minimum(np.maximum(np.asarray(v, dtype=np.float64), -most), most)

    def update(self, q: npt.ArrayLike, target: Pose) -> Instruction:
        """Return the joint targets that bring the tool nearer to its target, and hold it there.

        Args:
            q: measured joint angles (N,) [rad or m].
            target: where the tool shall be.

        Returns:
            The reference now, and its speeds in the coming period.

        Raises:
            Refusal: q of a wrong length, not finite or too large. Nothing has changed then.
            ArithmeticError: the robot description holds numbers that cannot be computed with.
        """
        q = self.kinematics.vector(q)
        notices = self._find_reference(q)
        if target is not self._target:
            self._target = target
            self._goal.aim(target, self._q)
            self._searching = False
        if not self._goal.settled:
            self._goal.approach(STEPS)
        elif not self._goal.reached:
            self._look_elsewhere(target, notices)
        self._goal_before = None
        lower, upper = self._box.lower, self._box.upper
        if self._goal.returning or (self._goal.settled and not self._goal.reached):
            # The way ends or begins at a singular pose: an elbow that passed it would have flipped.
            end = self._goal.q
            lower = np.maximum(lower, np.minimum(self._q, end))
            upper = np.minimum(upper, np.maximum(self._q, end))
        low, high = self._box.bounds(self._q, self._v, lower, upper)
        wanted, J = self._along_the_way(low, high, lower, upper)
        return self._go(q, target, wanted, J, low, high, notices)

    def follow(self, q: npt.ArrayLike, pose: Pose, twist: npt.ArrayLike) -> Instruction:
        """Return the joint targets with which the tool follows a moving pose.

        Args:
            q: measured joint angles (N,) [rad or m].
            pose: where the tool shall be now.
            twist: its speed in the coming period, translation and rotation along the world's axes,
                (6,) [m/s, rad/s].

        Returns:
            The reference now, and its speeds in the coming period.

        Raises:
            Refusal, ArithmeticError: as `update`.
        """
        q = self.kinematics.vector(q)
        notices = self._find_reference(q)
        move = self.period * np.asarray(twist, dtype=np.float64)
        coming = Pose(pose.p_WT + move[:3], pin.exp3(move[3:]) @ pose.R_WT)
        if self._goal_before is None:
            self._goal.aim(pose, self._q)
            self._goal.approach(4 * STEPS)
            self._goal_before = self._goal.q
        here = self._goal_before
        self._target, self._searching = None, False
        self._goal.aim(coming, self._q)
        self._goal.approach(STEPS)
        there = self._goal_before = self._goal.q
        behind = here - self._q
        wanted = (there - here) / self.period
        wanted += self._box.approach(behind, _BRAKES)
        J = self._scales * self.kinematics.jacobian(self._q)
        low, high = self._box.bounds(self._q, self._v)
        instruction = self._go(q, pose, wanted, J, low, high, notices)
        if np.abs(behind / self.kinematics.joint_scale).max() > 1e-3:
            self.notices += (f"behind the path by {np.linalg.norm(self.error[:3]):.3g} m",)
        return instruction

    def _begin(self, q: FloatArray) -> None:
        self._began = True
        self._q, self._v = q.copy(), np.zeros(len(q))
        self._goal.begin(q)
        self._target = self._end_q = self._goal_before = self._q_measured = None

    def _limit(self, velocity: float, acceleration: float) -> None:
        kinematics = self.kinematics
        self._velocity = np.minimum(_SPEED_SHARE * kinematics.velocity_limit, velocity)
        self._box = SpeedBox(
            kinematics.lower,
            kinematics.upper,
            self._velocity,
            np.minimum(kinematics.acceleration_limit, acceleration),
            self.period,
        )

    def _find_reference(self, q: FloatArray) -> list[str]:
        """Begin anew where the arm is if that is far from the reference; report it."""
        notices = []
        if not self._began:
            self._begin(q)
        off = float(np.abs((q - self._q) / self.kinematics.joint_scale).max())
        if off > LOST:
            before = self._q_measured
            self.begin(q, None if before is None else (q - before) / self.period)
            notices.append(f"the arm was {off:.2g} rad from its reference, which began anew there")
        self._q_measured = q
        return notices

    @property
    def searching(self) -> bool:
        """Whether it still looks for a configuration that reaches the target."""
        return self._searching and not self._elsewhere.over

    def _look_elsewhere(self, target: Pose, notices: list[str]) -> None:
        """Where the arm rests at the nearest point, look for a configuration that reaches."""
        if not self._searching:
            rest = np.abs((self._goal.q - self._q) / self.kinematics.joint_scale).max() < _REST
            if not rest:
                return
            self._searching = True
            self._elsewhere.begin(target, self._q)
        # As many per time whatever the period: it takes some 5 s.
        found = self._elsewhere.search(max(STEPS, round(self.period / _SEARCH_TIME)))
        if found is not None:
            self._goal.take(found)
        elif self.searching:
            notices.append("looks for another configuration")

    def _along_the_way(
        self, low: FloatArray, high: FloatArray, lower: FloatArray, upper: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return the joint speeds wanted (N,), and the scaled Jacobian.

        Args:
            low: speeds (N,) that are within the limits, if possible.
            high: (N,).
            lower: positions (N,) that the way keeps within.
            upper: (N,).
        """
        kinematics, box, now = self.kinematics, self._box, self._q
        scale = kinematics.joint_scale
        line = (self._goal.q - now) / scale
        e, J = kinematics.error_and_jacobian(now, self._end())
        J = self._scales * J
        missed = kinematics.scale * e - J @ line
        squares, V = directions(J)
        bend = V @ ((V.T @ (J.T @ missed)) / np.maximum(squares, _SINGULAR**2))
        if len(e) > POSITION_ROWS:  # near half a turn the axis of the logarithm jumps
            turn = math.sqrt(float(e[POSITION_ROWS:] @ e[POSITION_ROWS:]))
            bend *= min(1.0, max(0.0, 2.0 * (1.0 - turn / 3.0)))
        to_lower, to_upper = (lower - now) / scale, (upper - now) / scale
        bend = np.minimum(np.maximum(line + bend, to_lower), to_upper) - line
        # However it bends, the way must lead nearer to the joint goal: so it ends there.
        length, along = float(line @ line), float(line @ bend)
        if along < -(1.0 - _NEARER) * length:
            bend *= -(1.0 - _NEARER) * length / along
        way = (line + bend) * scale
        return box.rate(way, _BRAKES, _APPROACH / self.period, low, high) * way, J

    def _end(self) -> Pose:
        """Return where the tool comes to rest."""
        q = self._goal.q
        if self._end_q is None or not np.array_equal(q, self._end_q):
            R_WT, p_WT = self.kinematics.forward(q)
            self._end_q, self._end_pose = q, Pose(p_WT, R_WT)
        return self._end_pose

    def _go(
        self,
        q: FloatArray,
        target: Pose,
        wanted: FloatArray,
        J: FloatArray,
        low: FloatArray,
        high: FloatArray,
        notices: list[str],
    ) -> Instruction:
        """Answer with the reference now, and move it on with the speeds nearest to those wanted."""
        scale, goal, box = self.kinematics.joint_scale, self._goal, self._box
        v = np.minimum(np.maximum(wanted, low), high)
        if np.abs(v - wanted).max() > 1e-9:
            H = _TOOL_WEIGHT * (J.T @ J) + np.eye(len(v))
            v = scale * solve_in_box(H, H @ (wanted / scale), low / scale, high / scale)
            v = np.minimum(np.maximum(v, low), high)
        if not np.isfinite(v).all():
            raise ArithmeticError(f"the joint speeds are not finite at q = {q}")
        instruction = Instruction(self._q, v)
        q_next = self._q + self.period * v
        # Within the limits to the last bit, unless it began outside.
        lower, upper = np.minimum(box.lower, self._q), np.maximum(box.upper, self._q)
        self._q, self._v = np.minimum(np.maximum(q_next, lower), upper), v
        self.error = self.kinematics.tool_error(q, target)
        if goal.settled and not goal.reached:
            notices.append(self._unreachable())
        self.notices = tuple(notices)
        return instruction

    def _unreachable(self) -> str:
        goal, kinematics = self._goal, self.kinematics
        error = goal.error / kinematics.scale
        words = f"unreachable: the nearest point is {np.linalg.norm(error[:3]):.3g} m"
        if len(error) > POSITION_ROWS:
            words += f" and {np.linalg.norm(error[3:]):.3g} rad"
        words += " away"
        at = (goal.q <= kinematics.lower) | (goal.q >= kinematics.upper)
        if at.any():
            names = ", ".join(kinematics.joint_names[j] for j in np.flatnonzero(at))
            words += f", {names} at the limit"
        return words
