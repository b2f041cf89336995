"""Joint trajectories: points over logical time, and the spline of the joints through them.

Semantics of ros2_control's joint_trajectory_controller
(https://control.ros.org/jazzy/doc/ros2_controllers/joint_trajectory_controller/doc/trajectory.html):
between two points the joints go straight where only positions are given. They follow a cubic where
both points have velocities, and a quintic where both have accelerations, too. A trajectory begins
at its stamp, from the positions and speeds commanded at that time, so that nothing jumps. Points
that are past are left out. Joints that it does not name come to rest.
"""

import bisect
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from arm_emulator.base.arrays import Array
from arm_emulator.base.refusal import Refusal
from arm_emulator.base.validation.bound import ACCELERATION, EFFORT, POSITION, VELOCITY
from arm_emulator.base.validation.joint_order import check_joints_exist
from arm_emulator.base.validation.number import Number
from arm_emulator.motion.model.joint_reference import Reference
from arm_emulator.motion.trajectory.joint_curve import find_excess

WHERE = "joint_trajectory"
MAX_POINTS = 10_000
AT_REST = float(np.finfo(np.float32).eps)  # rad/s: what counts as speed 0 at the end
# A planner's points keep the limits; a spline through them is a little faster here and there, where
# the planner changes its acceleration between two of them.
SPEED_BETWEEN_POINTS = 1.05
ROUNDING = 1e-6  # of a limit, and rad: a text with seven digits

_SECONDS = 1e-9
_BOUNDS = {
    "positions": POSITION,
    "velocities": VELOCITY,
    "accelerations": ACCELERATION,
    "effort": EFFORT,
}


@dataclass(frozen=True, eq=False)
class JointLimits:
    """Limits of an arm's joints, (N,) each."""

    lower: Array
    """[rad]; -inf: no limit."""
    upper: Array
    """[rad]; inf: no limit."""
    speed: Array
    """[rad/s]; inf: no limit."""
    acceleration: Array
    """Used to come to rest [rad/s2], > 0."""
    continuous: npt.NDArray[np.bool_]
    """Whether the joint repeats after a turn."""


@dataclass(frozen=True)
class TrajectoryPoint:
    """One point, as trajectory_msgs/JointTrajectoryPoint has it: a value per joint, or none."""

    time_ns: int
    """From the start of the trajectory [ns]."""
    positions: Sequence[float]
    """[rad]."""
    velocities: Sequence[float] = ()
    """[rad/s]."""
    accelerations: Sequence[float] = ()
    """[rad/s2]."""
    effort: Sequence[float] = ()
    """Feed-forward torques at the links [N m]."""


class JointMotion:
    """Joint angles as polynomials of time, piece by piece; after it they rest.

    Args:
        starts_ns: when each piece begins, the first at 0 (S,) [ns].
        end_ns: when the last piece ends.
        coefficients: of each piece, in powers of the seconds since it began, (S, 6, N).
    """

    path_text = ""  # it keeps its times, see `TimedMotion`

    def __init__(self, starts_ns: Sequence[int], end_ns: int, coefficients: Array) -> None:
        self.starts_ns, self.end_ns, self.coefficients = list(starts_ns), end_ns, coefficients
        self.duration = end_ns * _SECONDS

    @property
    def durations(self) -> Array:
        """Durations of the pieces (S,) [s]."""
        return _compute_seconds([*self.starts_ns, self.end_ns])

    def find_requested_ns(self, time: float) -> int:
        """See `TimedMotion`."""
        return round(time / _SECONDS)

    def evaluate_at(self, time: float) -> Reference:
        """Return the joints at a time since its begin [s]."""
        time_ns = round(time / _SECONDS)
        within = min(time_ns, self.end_ns)
        piece = max(0, bisect.bisect_right(self.starts_ns, within) - 1)
        c, t = self.coefficients[piece], (within - self.starts_ns[piece]) * _SECONDS
        q, v, a = c[5].copy(), np.zeros_like(c[5]), np.zeros_like(c[5])
        for row in c[4::-1]:  # Horner's rule, for the derivatives too
            a = a * t + 2.0 * v
            v = v * t + q
            q = q * t + row
        if within != time_ns or time_ns == self.end_ns:
            v, a = np.zeros_like(v), np.zeros_like(a)
        return Reference(q, v, a)


def plan_rest(q: Array, v: Array, acceleration: Array) -> JointMotion:
    """Return the motion that brings all joints to rest together, straight on in joint space.

    Args:
        q: angles at its begin (N,) [rad].
        v: speeds then (N,) [rad/s].
        acceleration: at most (N,) [rad/s2].
    """
    seconds = float(np.max(np.abs(v) / acceleration))
    duration_ns = max(1, math.ceil(seconds / _SECONDS))
    c = np.zeros((1, 6, len(q)))
    c[0, 0] = q
    if seconds > 0.0:
        c[0, 1], c[0, 2] = v, -0.5 * v / (duration_ns * _SECONDS)
    return JointMotion([0], duration_ns, c)


class JointTrajectory:
    """A checked trajectory.

    Args:
        joint_names: all joints of the arm, (N,).
        limits: of these joints.
        names: joints that the trajectory moves.
        points: none: the joints come to rest where they are.
        stamp_ns: logical time at which it starts [ns]; 0: at once.
        may_end_moving: whether the speed of the last point may differ from 0.

    Raises:
        Refusal: names, times or numbers that are not taken, or limits that it does not keep.
    """

    def __init__(
        self,
        joint_names: Sequence[str],
        limits: JointLimits,
        names: Sequence[str],
        points: Sequence[TrajectoryPoint],
        stamp_ns: int = 0,
        may_end_moving: bool = False,
    ) -> None:
        self.stamp_ns = stamp_ns
        self.limits = limits
        self.joint_names = tuple(joint_names)
        self.moved = _find_joints(self.joint_names, names, bool(points))
        """Index of each joint that is named, (M,)."""
        check_number_of_points(len(points))
        self.times_ns = [point.time_ns for point in points]
        """Times of the points, from the start [ns]."""
        _check_times(self.times_ns)
        _check_kinds(points)
        count = len(self.moved)
        self.q, self.v, self.a, self.tau = (_read_table(points, field, count) for field in _BOUNDS)
        """Values at the points, (K, M) each; rows of NaN where nothing is given."""
        if not points:
            return
        if not may_end_moving and (np.abs(self.v[-1]) > AT_REST).any():
            raise Refusal(
                WHERE,
                f"points[{len(points) - 1}].velocities",
                "be 0 rad/s at the end of the trajectory",
                self.v[-1].tolist(),
            )
        self._check_points()
        self._pieces = _fit_hermite(self.times_ns, self.q, self.v, self.a)
        self._check_between(self._pieces, self.times_ns)

    @property
    def is_stop(self) -> bool:
        """Whether there are no points: the joints come to rest."""
        return not self.times_ns

    def begin_motion(self, now_ns: int, start_ns: int, now: Reference) -> JointMotion:
        """Return the motion of all joints from now on.

        Args:
            now_ns: logical time at which it takes over [ns].
            start_ns: from which the times of its points count [ns], not after `now_ns`.
            now: commanded motion of the joints.

        Raises:
            Refusal: all points are past, or the first one is too far away to be reached in time.
                Nothing has changed then.
        """
        moved, limits = self.moved, self.limits
        q, v, a = now.q, now.v, now.a
        rest = plan_rest(q, v, limits.acceleration)
        if self.is_stop:
            return rest
        times = [start_ns - now_ns + time for time in self.times_ns]
        first = bisect.bisect_right(times, 0)
        if first == len(times):
            end_ns = now_ns + times[-1]
            value = f"{end_ns * _SECONDS:g} s, at {now_ns * _SECONDS:g} s"
            raise Refusal(WHERE, "the time of the last point", "be still to come", value)
        revolutions = np.where(
            limits.continuous[moved],
            2.0 * np.pi * np.round((q[moved] - self.q[first]) / (2.0 * np.pi)),
            0.0,
        )
        there = np.stack([q[moved], self.q[first] + revolutions])
        speeds = np.stack([v[moved], self.v[first]])
        accelerations = np.stack([a[moved], self.a[first]])
        approach = _fit_hermite([0, times[first]], there, speeds, accelerations)
        self._check_between(approach, [0, times[first]], "the way to the first point")
        pieces = self._pieces[first:].copy()
        pieces[:, 0] += revolutions
        own = JointMotion([0, *times[first:-1]], times[-1], np.concatenate([approach, pieces]))
        return _merge_motions(own, moved, rest)

    def compute_effort(self, time_ns: int) -> Array | None:
        """Return the torques given for a time since its start [ns], straight between points.

        (N,) [N m], 0 for joints that are not named; None where the points next to it have none.
        """
        times = self.times_ns
        later = min(bisect.bisect_right(times, time_ns), len(times) - 1)
        before = max(0, later - 1) if time_ns < times[later] else later
        span = times[later] - times[before]
        part = min(1.0, max(0.0, (time_ns - times[before]) / span)) if span else 0.0
        torques = self.tau[before] + part * (self.tau[later] - self.tau[before])
        if np.isnan(torques).any():
            return None
        tau = np.zeros(len(self.joint_names))
        tau[self.moved] = torques
        return tau

    def _check_points(self) -> None:
        """Refuse points beyond the limits of position and speed."""
        m, limits = self.moved, self.limits
        low, high = limits.lower[m] - ROUNDING, limits.upper[m] + ROUNDING
        fastest = limits.speed[m] * (1.0 + ROUNDING)
        with np.errstate(invalid="ignore"):
            outside = (self.q < low) | (self.q > high)
            fast = np.abs(self.v) > fastest
        for wrong, field, table, unit in (
            (outside, "positions", self.q, "rad"),
            (fast, "velocities", self.v, "rad/s"),
        ):
            if wrong.any():
                point, at = np.argwhere(wrong)[0]
                bounds = f"{self._format_range(at, field)} {unit}"
                rule = f"keep the limits of {self._name_point(at)}, {bounds}"
                raise Refusal(WHERE, f"points[{point}].{field}", rule, f"{table[point, at]:.6g}")

    def _check_between(
        self, pieces: Array, times_ns: Sequence[int], quantity: str = "the spline"
    ) -> None:
        """Refuse pieces (S, 6, M) that leave the limits between their ends."""
        if not len(pieces):
            return
        m, limits = self.moved, self.limits
        seconds = _compute_seconds(times_ns)
        for order, field, low, high, unit in (
            (0, "positions", limits.lower[m] - ROUNDING, limits.upper[m] + ROUNDING, "rad"),
            (
                1,
                "velocities",
                -SPEED_BETWEEN_POINTS * limits.speed[m],
                SPEED_BETWEEN_POINTS * limits.speed[m],
                "rad/s",
            ),
        ):
            excess = find_excess(pieces, seconds, order, low, high)
            if excess is not None:
                piece, at, value = excess
                bounds = f"{self._format_range(at, field)} {unit}"
                rule = f"keep the limits of {self._name_point(at)}, {bounds}"
                where = f"{quantity}" if len(pieces) == 1 else f"{quantity} after points[{piece}]"
                raise Refusal(WHERE, where, rule, f"{value:.6g} {unit}")

    def _name_point(self, at: int) -> str:
        return self.joint_names[int(self.moved[at])]

    def _format_range(self, at: int, field: str) -> str:
        limits, joint = self.limits, self.moved[at]
        if field == "positions":
            return f"[{limits.lower[joint]:.6g}, {limits.upper[joint]:.6g}]"
        return f"+-{limits.speed[joint]:.6g}"


def check_number_of_points(count: int) -> None:
    """Refuse too many points."""
    if count > MAX_POINTS:
        raise Refusal(WHERE, "points", f"be at most {MAX_POINTS}", count)


def _find_joints(
    joint_names: tuple[str, ...], names: Sequence[str], needed: bool
) -> npt.NDArray[np.int64]:
    """Return the index of each name among the arm's joints."""
    places, valid = {name: i for i, name in enumerate(joint_names)}, ", ".join(joint_names)
    check_joints_exist(WHERE, names, joint_names)
    if len(set(names)) != len(names) or (needed and not names):
        value = ", ".join(names) or "none"
        raise Refusal(WHERE, "joint_names", "name some joints, each once", value, valid)
    return np.array([places[name] for name in names], dtype=np.int64)


def _check_times(times_ns: Sequence[int]) -> None:
    for i, time in enumerate(times_ns):
        if time < 0:
            where = f"points[{i}].time_from_start"
            raise Refusal(WHERE, where, "be >= 0 s", f"{time * _SECONDS:g} s")
        if i and time <= times_ns[i - 1]:
            raise Refusal(
                WHERE,
                f"points[{i}].time_from_start",
                f"be later than the previous point's, {times_ns[i - 1] * _SECONDS:g} s",
                f"{time * _SECONDS:g} s",
            )
    if times_ns and times_ns[-1] == 0:
        rule = "be > 0 s in the last point: no joint arrives in no time"
        raise Refusal(WHERE, "time_from_start", rule, "0 s")


def _check_kinds(points: Sequence[TrajectoryPoint]) -> None:
    for i, point in enumerate(points):
        if len(point.accelerations) and not len(point.velocities):
            rule = "be given where accelerations are"
            raise Refusal(WHERE, f"points[{i}].velocities", rule, "none")


def _read_table(points: Sequence[TrajectoryPoint], field: str, count: int) -> Array:
    """Return a field of all points, (K, M); NaN where a point has none."""
    table = np.full((len(points), count), math.nan)
    needed = field == "positions"
    for i, point in enumerate(points):
        values = getattr(point, field)
        if needed or len(values):
            bound: Number = _BOUNDS[field].rename(f"points[{i}].{field}")
            table[i] = bound.check_row(WHERE, values, count)
    return table


def _compute_seconds(times_ns: Sequence[int]) -> Array:
    return np.diff(np.array(times_ns, dtype=np.int64)).astype(np.float64) * _SECONDS


def _fit_hermite(times_ns: Sequence[int], q: Array, v: Array, a: Array) -> Array:
    """Return the pieces between points, (K - 1, 6, M).

    Where the speeds of an end are NaN a piece is straight, where its accelerations are, cubic.
    """
    T = _compute_seconds(times_ns)[:, None]
    q0, v0, a0, v1, a1 = q[:-1], v[:-1], a[:-1], v[1:], a[1:]
    mean = np.diff(q, axis=0) / T
    c = np.zeros((len(T), 6, q.shape[1]))
    c[:, 0], c[:, 1] = q0, mean
    cubic = ~np.isnan(v0 + v1)
    c[:, 1] = np.where(cubic, v0, c[:, 1])
    c[:, 2] = np.where(cubic, (3.0 * mean - 2.0 * v0 - v1) / T, 0.0)
    c[:, 3] = np.where(cubic, (v0 + v1 - 2.0 * mean) / T**2, 0.0)
    quintic = cubic & ~np.isnan(a0 + a1)
    c[:, 2] = np.where(quintic, 0.5 * a0, c[:, 2])
    third = (10.0 * mean - 6.0 * v0 - 4.0 * v1) / T**2 - (1.5 * a0 - 0.5 * a1) / T
    fourth = (-15.0 * mean + 8.0 * v0 + 7.0 * v1) / T**3 + (1.5 * a0 - a1) / T**2
    fifth = (6.0 * mean - 3.0 * (v0 + v1)) / T**4 + 0.5 * (a1 - a0) / T**3
    c[:, 3] = np.where(quintic, third, c[:, 3])
    c[:, 4] = np.where(quintic, fourth, 0.0)
    c[:, 5] = np.where(quintic, fifth, 0.0)
    return c


def _merge_motions(
    own: JointMotion, moved: npt.NDArray[np.int64], rest: JointMotion
) -> JointMotion:
    """Return the motion of all joints: those in `moved` by `own`, the others by `rest`."""
    count = rest.coefficients.shape[2]
    if len(moved) == count:
        coefficients = np.empty_like(own.coefficients)
        coefficients[:, :, moved] = own.coefficients
        return JointMotion(own.starts_ns, own.end_ns, coefficients)
    starts = sorted({*own.starts_ns, own.end_ns, rest.end_ns})
    end = max(own.end_ns, rest.end_ns)
    starts = [start for start in starts if start < end]
    coefficients = np.zeros((len(starts), 6, count))
    for i, start in enumerate(starts):
        coefficients[i] = _shift_piece(rest, start)
        coefficients[i][:, moved] = _shift_piece(own, start)
    return JointMotion(starts, end, coefficients)


def _shift_piece(motion: JointMotion, start_ns: int) -> Array:
    """Return the piece that holds at a time, in powers of the seconds since then, (6, N)."""
    if start_ns >= motion.end_ns:
        c: Array = np.zeros_like(motion.coefficients[0])
        c[0] = motion.evaluate_at(motion.duration).q
        return c
    piece = max(0, bisect.bisect_right(motion.starts_ns, start_ns) - 1)
    t = (start_ns - motion.starts_ns[piece]) * _SECONDS
    powers = [
        [math.comb(k, i) * t ** (k - i) if k >= i else 0.0 for k in range(6)] for i in range(6)
    ]
    return np.asarray(np.array(powers) @ motion.coefficients[piece])
