"""Tool paths: poses in a row, and where the tool is on its way through them over logical time.

The tool first goes to the first pose from where it is, at the speed that it has there, and rests in
it. Then it follows the curve of tool_curve.py at a tool speed, or so that it is in each pose at the
time that the pose is stamped with.

Where the curve has a corner its direction steps. The tool passes a corner at the speed at which
this step is what its acceleration makes of its velocity in one motion period: a right angle at
35 mm/s with 1 m/s2 and 50 ms. Small corners in a row, nearer to each other than what the tool goes
in a motion period, are a bend. Bends, arcs and rounded corners are passed as fast as the
acceleration across allows.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pinocchio as pin
import ruckig

from arm_emulator.base.refusal import Refusal
from arm_emulator.motion.pose import Pose
from arm_emulator.motion.speed_profile import SpeedProfile
from arm_emulator.motion.tool_curve import ToolCurve

FloatArray = npt.NDArray[np.float64]

WHERE = "tool_path"
MOST_POSES = 5000
LONGEST = 1000.0  # m, of the whole path and of the way to it
LONGEST_TIME = 1e6  # s
ALONE = 0.1  # of the kink that may be passed at full speed: what is smaller does not count
RESIDUE = 1e-9  # m and m/s: rounding of a tool that is in its pose, or at rest

_SECONDS = 1e-9


@dataclass(frozen=True)
class ToolLimits:
    """How the tool may go along a path; all > 0."""

    speed: float
    """[m/s]."""
    turn_speed: float
    """[rad/s]."""
    acceleration: float
    """Along the path, and again across it [m/s2]; of turning in proportion."""
    jerk: float
    """Along the path [m/s3]; of turning in proportion."""
    period: float
    """In which a velocity may step by what the acceleration makes of it [s]: the motion period."""

    @property
    def per_turn(self) -> float:
        """Distance gone in the time of a turn by 1 rad [m/rad]."""
        return self.speed / self.turn_speed


@dataclass(frozen=True, eq=False)
class ToolState:
    """Where the tool is and how it moves, along the world's axes."""

    pose: Pose
    v: FloatArray
    """Velocity (3,) [m/s]."""
    omega: FloatArray
    """Angular velocity (3,) [rad/s]."""

    @classmethod
    def at_rest(cls, pose: Pose) -> ToolState:
        """Return a tool that does not move."""
        return cls(pose, np.zeros(3), np.zeros(3))


class ToolPath:
    """A path that was checked, at the door, once.

    Args:
        poses: through which the tool goes, one or more.
        limits: how.
        stamp_ns: logical time at which the way to the first pose begins [ns]; 0: at once.
        times_ns: when the tool is in each pose, strictly increasing (K,) [ns]; None: as the limits
            allow.
        arcs: see `ToolCurve`.
        blend: see `ToolCurve`; with times the tool goes through every corner.

    Raises:
        Refusal: no poses or too many, times that are not in order, or a path too long.
    """

    def __init__(
        self,
        poses: Sequence[Pose],
        limits: ToolLimits,
        stamp_ns: int = 0,
        times_ns: Sequence[int] | None = None,
        arcs: bool = False,
        blend: float = 0.0,
    ) -> None:
        check_number_of_poses(len(poses))
        self.stamp_ns, self.limits, self.first = stamp_ns, limits, poses[0]
        self._times_ns = None if times_ns is None else _in_order(times_ns, len(poses))
        timed = self._times_ns is not None
        self._curve = ToolCurve(
            [poses[0], *poses] if len(poses) == 1 else poses,
            limits.per_turn,
            arcs,
            0.0 if timed else blend,
        )
        length = float(self._curve.at_poses[-1])
        if length > LONGEST:
            raise Refusal(WHERE, "the path", f"be at most {LONGEST:g} m long", f"{length:.6g} m")
        self._profile: SpeedProfile | _Timed
        if timed:
            self._profile = _Timed(np.array(self._times_ns), self._curve.at_poses)
        else:
            self._profile = _as_limits_allow(self._curve, limits)
        if self._profile.duration > LONGEST_TIME:
            got = f"{self._profile.duration:.6g} s"
            raise Refusal(WHERE, "the path", f"take at most {LONGEST_TIME:g} s", got)

    @property
    def last(self) -> Pose:
        """Where the path ends."""
        return self.at(math.inf).pose

    def begin(self, now_ns: int, state: ToolState) -> ToolMotion:
        """Return the motion of the tool from now on.

        Args:
            now_ns: logical time [ns].
            state: of the tool now.

        Raises:
            Refusal: the first pose is too far away, or cannot be reached by its time.
        """
        way = _WayIn(state, self.first, self.limits)
        arrival = now_ns + math.ceil(way.duration / _SECONDS)
        start = arrival
        if self._times_ns is not None:
            start = self._times_ns[0]
            if arrival > start:
                rule = f"leave the tool {way.duration:.3g} s to reach it"
                got = f"{(start - now_ns) * _SECONDS:.6g} s"
                raise Refusal(WHERE, "the time of the first pose", rule, got)
        return ToolMotion(self, way, now_ns, start)

    @property
    def duration(self) -> float:
        """Time from the first pose to the last one [s]."""
        return self._profile.duration

    def at(self, time: float) -> ToolState:
        """Return the tool a time after the first pose [s]."""
        if not len(self._curve):
            return ToolState.at_rest(self.first)
        x, speed, _ = self._profile.sample(time)
        p, R, v, omega = self._curve.sample(x)
        return ToolState(Pose(p, R), speed * v, speed * omega)


class ToolMotion:
    """A tool on its way to a path and along it, over logical time.

    Attributes:
        end_ns: when it is in the last pose.
    """

    def __init__(self, path: ToolPath, way: _WayIn, now_ns: int, start_ns: int) -> None:
        self._path, self._way, self._now_ns, self._start_ns = path, way, now_ns, start_ns
        self.end_ns = start_ns + math.ceil(path.duration / _SECONDS)

    def sample(self, time_ns: int) -> ToolState:
        """Return where the tool shall be, and how it shall move, at a logical time."""
        if time_ns < self._start_ns:
            return self._way.at((time_ns - self._now_ns) * _SECONDS)
        return self._path.at((time_ns - self._start_ns) * _SECONDS)


def check_number_of_poses(count: int) -> None:
    """Refuse no poses, or too many."""
    if not 1 <= count <= MOST_POSES:
        raise Refusal(WHERE, "poses", f"be from 1 to {MOST_POSES}", count)


def _in_order(times_ns: Sequence[int], count: int) -> list[int]:
    if len(times_ns) != count:
        raise Refusal(WHERE, "header.stamp", f"be given for all of {count} poses", len(times_ns))
    for i in range(1, count):
        if times_ns[i] <= times_ns[i - 1]:
            raise Refusal(
                WHERE,
                f"poses[{i}].header.stamp",
                f"be later than the previous pose's, {times_ns[i - 1] * _SECONDS:g} s",
                f"{times_ns[i] * _SECONDS:g} s",
            )
    return list(times_ns)


def _as_limits_allow(curve: ToolCurve, limits: ToolLimits) -> SpeedProfile:
    """Return the profile over stretches of one speed: neighbours that have the same are joined."""
    if not len(curve):
        return SpeedProfile([], [], [], limits.acceleration, limits.jerk)
    step = limits.acceleration * limits.period  # of velocity, that a kink may make
    kinks = curve.kinks()
    near = 2.0 * limits.speed * limits.period
    alone = _turned_within(curve, kinks, near) - kinks < ALONE * step / limits.speed
    with np.errstate(divide="ignore"):
        speeds = np.sqrt(limits.acceleration / curve.curvature())
        meeting = np.where(alone, step / kinks, np.inf)
    bends = _bend_speeds(curve, np.where(alone, 0.0, kinks), step, limits)
    speeds = np.minimum(speeds, np.minimum(np.append(bends, np.inf), np.append(np.inf, bends)))
    speeds = _evened_out(curve, speeds, limits)
    last = np.append(
        (meeting < np.minimum(speeds[:-1], speeds[1:])) | (speeds[:-1] != speeds[1:]), True
    )
    return SpeedProfile(
        np.diff(curve.ends[last], prepend=0.0).tolist(),
        speeds[last].tolist(),
        meeting[last[:-1]].tolist(),
        limits.acceleration,
        limits.jerk,
    )


def _bend_speeds(
    curve: ToolCurve, kinks: FloatArray, step: float, limits: ToolLimits
) -> FloatArray:
    """Return the speeds at which kinks in a row may be passed, (S - 1,) [m/s].

    As a bend: what the tool passes within a motion period may change its velocity by `step`.
    """
    fastest = np.zeros_like(kinks)
    for speed in _grid(limits):
        turned = _turned_within(curve, kinks, speed * limits.period)
        with np.errstate(divide="ignore"):
            fastest = np.maximum(fastest, np.minimum(speed, step / turned))
    return fastest


def _turned_within(curve: ToolCurve, kinks: FloatArray, window: float) -> FloatArray:
    """Return the sum of the kinks in a window around each of them, (S - 1,)."""
    at, total = curve.ends[:-1], np.concatenate([[0.0], np.cumsum(kinks)])
    first = np.searchsorted(at, at - 0.5 * window, side="left")
    end = np.searchsorted(at, at + 0.5 * window, side="right")
    return np.asarray(np.maximum(total[end] - total[first], kinks))


def _evened_out(curve: ToolCurve, speeds: FloatArray, limits: ToolLimits) -> FloatArray:
    """Return speeds that are not larger, of few values, and the same for a motion period or so.

    Between stretches of different speeds the tool does not accelerate. With many short ones it
    would not get going.
    """
    grid = _grid(limits)
    speeds = grid[np.minimum(np.searchsorted(-grid, -speeds, side="left"), len(grid) - 1)]
    half = 0.5 * limits.speed * limits.period
    first = np.searchsorted(curve.ends, curve.ends - curve.length - half, side="right")
    end = np.searchsorted(curve.ends - curve.length, curve.ends + half, side="left")
    lowest = [speeds[i:j].min() for i, j in zip(first, end, strict=True)]
    return np.array(lowest)


def _grid(limits: ToolLimits) -> FloatArray:
    """Return speeds from the largest one down."""
    return np.asarray(limits.speed * 0.9 ** np.arange(60))


class _Timed:
    """Distance over given times: between them a cubic that never goes back.

    Slopes as of Fritsch and Butland (1984), at rest at both ends.
    """

    def __init__(self, times_ns: npt.NDArray[np.int64], distance: FloatArray) -> None:
        self._t = (times_ns - times_ns[0]) * _SECONDS
        self._s = distance
        self.duration = float(self._t[-1])
        h = np.diff(self._t)
        m = np.diff(distance) / h
        self._v = np.zeros_like(distance)
        with np.errstate(divide="ignore"):
            early, late = 2.0 * h[1:] + h[:-1], h[1:] + 2.0 * h[:-1]
            self._v[1:-1] = (early + late) / (early / m[:-1] + late / m[1:])

    def sample(self, time: float) -> tuple[float, float, float]:
        """As `SpeedProfile.sample`."""
        if time <= 0.0 or len(self._t) < 2:
            return 0.0, 0.0, 0.0
        if time >= self.duration:
            return float(self._s[-1]), 0.0, 0.0
        i = int(np.searchsorted(self._t, time, side="right")) - 1
        h, t = self._t[i + 1] - self._t[i], time - self._t[i]
        v0, v1, mean = self._v[i], self._v[i + 1], (self._s[i + 1] - self._s[i]) / h
        c, d = (3.0 * mean - 2.0 * v0 - v1) / h, (v0 + v1 - 2.0 * mean) / h**2
        s = self._s[i] + t * (v0 + t * (c + t * d))
        return float(s), float(v0 + t * (2.0 * c + 3.0 * t * d)), float(2.0 * c + 6.0 * t * d)


class _WayIn:
    """From where the tool is, as it moves there, to rest in a pose: jerk-limited, by ruckig.

    Six coordinates, all at their ends at the same time: the position along the line to the pose
    and across it, and the rotation vector from the pose times `per_turn`. From rest this is a line,
    and the orientation turns about one axis.
    """

    def __init__(self, state: ToolState, to: Pose, limits: ToolLimits) -> None:
        self._to, self._per_turn = to, limits.per_turn
        step = state.pose.p_WT - to.p_WT
        rotation = pin.log3(state.pose.R_WT @ to.R_WT.T)
        distance = max(
            float(np.linalg.norm(step)), self._per_turn * float(np.linalg.norm(rotation))
        )
        if distance > LONGEST:
            raise Refusal(WHERE, "poses[0]", f"be within {LONGEST:g} m", f"{distance:.6g} m away")
        self._axes = np.zeros((6, 6))
        self._axes[:3, :3], self._axes[3:, 3:] = _basis(step), _basis(rotation)
        rate = np.linalg.inv(_left_jacobian(rotation)) @ state.omega
        self._trajectory = _to_rest(
            self._along(step, rotation), self._along(state.v, rate), limits, distance
        )
        self.duration = float(self._trajectory.duration)

    def at(self, time: float) -> ToolState:
        """Return the tool a time after the start [s]; at its end it rests in the pose."""
        if time >= self.duration:
            return ToolState.at_rest(self._to)
        position, velocity, _ = self._trajectory.at_time(max(0.0, time))
        x, dx = self._axes @ np.array(position), self._axes @ np.array(velocity)
        rotation = x[3:] / self._per_turn
        return ToolState(
            Pose(self._to.p_WT + x[:3], pin.exp3(rotation) @ self._to.R_WT),
            dx[:3],
            _left_jacobian(rotation) @ (dx[3:] / self._per_turn),
        )

    def _along(self, position: FloatArray, rotation: FloatArray) -> list[float]:
        both = np.concatenate([position, self._per_turn * rotation])
        along = self._axes.T @ both
        return [0.0 if abs(x) < RESIDUE else float(x) for x in along]


def _to_rest(
    position: list[float], velocity: list[float], limits: ToolLimits, distance: float
) -> ruckig.Trajectory:
    """Return the quickest way of six coordinates to rest at 0.

    All arrive together. Where Ruckig finds no such way (it compares times that differ by rounding)
    each coordinate arrives as soon as it can.
    """
    problem = ruckig.InputParameter(6)
    problem.current_position, problem.current_velocity = position, velocity
    problem.target_position = [0.0] * 6
    problem.max_velocity = [limits.speed] * 6
    problem.max_acceleration = [limits.acceleration] * 6
    problem.max_jerk = [limits.jerk] * 6
    why = ""
    for together in (ruckig.Synchronization.Phase, ruckig.Synchronization.No):
        problem.synchronization = together
        trajectory = ruckig.Trajectory(6)
        try:
            result = ruckig.Ruckig(6).calculate(problem, trajectory)
        except ruckig.RuckigError as error:
            why = str(error)
            continue
        if result in (ruckig.Result.Working, ruckig.Result.Finished):
            return trajectory
        why = result.name
    got = f"one {distance:.6g} m away ({why})"
    raise Refusal(WHERE, "poses[0]", "be where a way leads to", got)


def _basis(direction: FloatArray) -> FloatArray:
    """Return three orthogonal unit vectors, the first along a direction, as columns."""
    length = float(np.linalg.norm(direction))
    if length == 0.0:
        return np.eye(3)
    first = direction / length
    other = np.eye(3)[int(np.argmin(np.abs(first)))]
    second = np.cross(first, other)
    second /= np.linalg.norm(second)
    return np.stack([first, second, np.cross(first, second)], axis=1)


def _left_jacobian(rotation: FloatArray) -> FloatArray:
    """Return what makes the angular velocity along the world's axes of a rotation vector's rate."""
    return np.asarray(pin.Jexp3(-rotation))
