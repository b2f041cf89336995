"""Tool paths: poses in a row, and the curve through them with the places where the tool stops.

The tool first goes to the first pose, and rests in it. Then it follows the curve of `ToolCurve`, as
fast as limits of the tool and of the joints allow. If poses have stamps, it is in each pose at its
stamp.

Flat corners are rounded, so that the tool passes them no farther than `ROUNDED` away. Where the
direction still steps the tool stops: no joint can change its speed at once.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from arm_emulator.base.arrays import Array
from arm_emulator.base.refusal import Refusal
from arm_emulator.base.saved_objects import SharedObject
from arm_emulator.motion.model.pose import Pose
from arm_emulator.motion.trajectory.tool_line import Poses, compute_rotations

WHERE = "tool_path"
MAX_POSES = 5000
LONGEST = 1000.0  # m, of the whole path
ROUNDED = 5e-5  # m, of a pose in a flat corner
SHARP = 0.02  # m/m: where the change of a pose per measure steps by more, the tool stops

_SECONDS = 1e-9


@dataclass(frozen=True)
class ToolLimits:
    """Limits of the tool along a path; all > 0."""

    speed: float
    """[m/s]."""
    turn_speed: float
    """[rad/s]."""
    acceleration: float
    """Along the path, and again across it [m/s2]; of turning in proportion."""
    jerk: float
    """Along the path [m/s3]; of turning in proportion."""

    @property
    def per_turn(self) -> float:
        """Distance gone in the time of a turn by 1 rad [m/rad]."""
        return self.speed / self.turn_speed


class ToolPath:
    """A checked path.

    Args:
        poses: through which the tool goes, one or more.
        limits: of the tool.
        stamp_ns: logical time at which the way to the first pose begins [ns]; 0: at once.
        times_ns: when the tool is in each pose, strictly increasing (K,) [ns]; None: as the limits
            allow.
        arcs: see `ToolCurve`.
        blend: see `ToolCurve`; with times the tool goes through every corner.

    Attributes:
        curve: through the poses.
        stops: measures of the curve at which the tool rests, its begin and its end among them, (S,)
            [m]; one alone where the curve has no length.
        times: when the tool is in each pose, from the first one on (K,) [s]; None: see `times_ns`.

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
        self.stamp_ns, self.limits = stamp_ns, limits
        self.poses = list(poses)
        self.times_ns = None if times_ns is None else _check_order(times_ns, len(poses))
        timed = self.times_ns is not None
        self.curve = ToolCurve(
            [poses[0], *poses] if len(poses) == 1 else poses,
            limits.per_turn,
            arcs,
            0.0 if timed else blend,
            0.0 if timed else ROUNDED,
        )
        length = float(self.curve.at_poses[-1])
        if length > LONGEST:
            raise Refusal(WHERE, "the path", f"be at most {LONGEST:g} m long", f"{length:.6g} m")
        ends = np.concatenate([[0.0], self.curve.ends])
        sharp = (
            self.curve.measure_kinks() > SHARP if len(self.curve) > 1 else np.zeros(0, dtype=bool)
        )
        self.stops = ends[np.concatenate([[True], sharp, [len(self.curve) > 0]])[: len(ends)]]

    @property
    def first(self) -> Pose:
        """First pose of the path."""
        return self.poses[0]

    def describe_place(self, x: float) -> str:
        """Return the place of a measure x [m] on the path as text."""
        at = self.curve.at_poses * (self.curve.ends[-1] / max(self.curve.at_poses[-1], SAME))
        k = int(np.clip(np.searchsorted(at, x + SAME, side="right") - 1, 0, len(self.poses) - 1))
        return f"{max(0.0, x - at[k]):.3g} m after poses[{k}]"


def check_number_of_poses(count: int) -> None:
    """Refuse no poses, or too many."""
    if not 1 <= count <= MAX_POSES:
        raise Refusal(WHERE, "poses", f"be from 1 to {MAX_POSES}", count)


def _check_order(times_ns: Sequence[int], count: int) -> list[int]:
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


# Curves of the tool through poses: lines and arcs of circles, orientation turning evenly along.
#
# A curve is a row of segments. Along each one its measure x grows from 0 to `length`: the distance
# that the tool goes or, where it turns more than it goes, the angle by which it turns times
# `per_turn`. So a tool that stands and turns goes along its curve, too. Of the limits of speed and
# of turning speed, the stricter one is kept.

SAME = 1e-9  # m, and rad: poses no farther apart are the same
MIN_CUT = 2e-3  # m: shorter arcs would be passed as slowly as a stop
STRAIGHT = 1e-6  # of a distance: three points this near to a line lie on it


class _Segments(NamedTuple):
    """Arrays of all segments (S, ...), or the values of one of them (0-dimensional arrays)."""

    p0: Array
    R0: Array
    distance: Array
    tangent: Array
    normal: Array
    curvature: Array
    turn: Array


class ToolCurve(SharedObject):
    """Segments (S,), each from a pose to the next; segments between equal poses are left out.

    On a segment, with l the distance gone and k its curvature:

        p = p0 + tangent sin(k l) / k + normal (1 - cos(k l)) / k,   R = exp(turn x / length) R0

    Args:
        poses: through which it goes, two or more.
        per_turn: measure of a turn by 1 rad [m/rad], > 0.
        arcs: whether the poses 0, 1, 2, then 2, 3, 4 and so on lie on an arc of a circle each;
            three on a line stay on it.
        blend: where two lines meet, an arc begins this far before the corner [m], at most in the
            middle of a line.
        rounding: flat corners are rounded, whatever `blend` is, by an arc that passes them at this
            distance [m]. The arc begins `MIN_CUT` or more before the corner, or in the middle of a
            line.

    Attributes:
        length: measure of each segment (S,) [m].
        ends: measure from the start to the end of each segment (S,) [m].
        at_poses: measure from the start to each pose (K,) [m], were `blend` 0.
    """

    def __init__(
        self,
        poses: Sequence[Pose],
        per_turn: float,
        arcs: bool = False,
        blend: float = 0.0,
        rounding: float = 0.0,
    ) -> None:
        self._per_turn = per_turn
        points = np.array([pose.p_WT for pose in poses])
        segments = _make_lines(points, np.array([pose.R_WT for pose in poses]))
        if arcs:
            segments = _bend_to_arcs(points, segments)
        apart = (segments.distance > SAME) | (np.linalg.norm(segments.turn, axis=1) > SAME)
        measures = np.where(apart, self._measure_length(segments), 0.0)
        self.at_poses = np.concatenate([[0.0], np.cumsum(measures)])
        segments = _Segments(*(column[apart] for column in segments))
        if (blend > 0.0 or rounding > 0.0) and len(segments.distance) > 1:
            segments = _round_corners(segments, blend, rounding)
        self._segments = segments
        self.length = self._measure_length(segments)
        self.ends = np.cumsum(self.length)

    def __len__(self) -> int:
        """Return the number of segments."""
        return len(self.length)

    def draw_poses(self, x: Array) -> Poses:
        """Return the tool at measures x (K,) from the start, between 0 and the end."""
        i = np.minimum(np.searchsorted(self.ends, x, side="right"), len(self) - 1)
        part = np.clip(1.0 - (self.ends[i] - x) / self.length[i], 0.0, 1.0)
        segment = _Segments(*(column[i] for column in self._segments))
        k, length = segment.curvature, part * segment.distance
        bent = k > 0.0
        radius = 1.0 / np.where(bent, k, 1.0)
        ahead = np.where(bent, radius * np.sin(k * length), length)
        aside = np.where(bent, 2.0 * radius * np.sin(0.5 * k * length) ** 2, 0.0)
        p = segment.p0 + ahead[:, None] * segment.tangent + aside[:, None] * segment.normal
        return Poses(p, compute_rotations(part[:, None] * segment.turn) @ segment.R0)

    def compute_curvature(self) -> Array:
        """Return, for each segment, the acceleration across at measure speed 1, (S,) [1/m]."""
        rate = self._segments.distance / self.length
        return np.asarray(self._segments.curvature * rate**2)

    def measure_kinks(self) -> Array:
        """Return how much the change per measure differs where segments meet (S - 1,) [m/m].

        Of the position, or of the orientation times `per_turn`, whichever is larger.
        """
        segments = self._segments
        rate, angle = (
            (segments.distance / self.length)[:, None],
            (segments.curvature * segments.distance)[:, None],
        )
        leaving = rate * (segments.tangent * np.cos(angle) + segments.normal * np.sin(angle))
        position = np.linalg.norm(rate[1:] * segments.tangent[1:] - leaving[:-1], axis=1)
        turning = self._per_turn * segments.turn / self.length[:, None]
        orientation = np.linalg.norm(np.diff(turning, axis=0), axis=1)
        return np.asarray(np.maximum(position, orientation))

    def _measure_length(self, segments: _Segments) -> Array:
        angle = np.linalg.norm(segments.turn, axis=1)
        return np.asarray(np.maximum(segments.distance, self._per_turn * angle))


def _make_lines(points: Array, R: Array) -> _Segments:
    """Return the lines between points (K, 3), with the turns between orientations (K, 3, 3)."""
    step = np.diff(points, axis=0)
    lengths = np.linalg.norm(step, axis=1)
    relative = R[1:] @ np.swapaxes(R[:-1], 1, 2)
    return _Segments(
        p0=points[:-1],
        R0=R[:-1],
        distance=lengths,
        tangent=step / np.maximum(lengths, SAME)[:, None],
        normal=np.zeros_like(step),
        curvature=np.zeros_like(lengths),
        turn=np.array([pin.log3(R_step) for R_step in relative]).reshape(-1, 3),
    )


def _bend_to_arcs(points: Array, segments: _Segments) -> _Segments:
    """Return arcs instead of lines through each three points that are not on a line."""
    lengths, curvature = np.array(segments.distance), np.array(segments.curvature)
    tangent, normal = segments.tangent.copy(), segments.normal.copy()
    for i in range(0, len(points) - 2, 2):
        circle = _find_circle(*points[i : i + 3])
        if circle is None:
            continue
        center, axis = circle
        for j in (i, i + 1):
            out, to = points[j] - center, points[j + 1] - center
            radius = float(np.linalg.norm(out))
            angle = math.atan2(axis @ np.cross(out, to), out @ to) % (2.0 * math.pi)
            lengths[j], curvature[j] = radius * angle, 1.0 / radius
            tangent[j], normal[j] = np.cross(axis, out) / radius, -out / radius
    return segments._replace(distance=lengths, tangent=tangent, normal=normal, curvature=curvature)


def _round_corners(segments: _Segments, blend: float, rounding: float) -> _Segments:
    """Return the same segments with arcs where two lines meet, tangent to both."""
    tangent, lengths = segments.tangent, np.asarray(segments.distance)
    cosine = np.einsum("ij,ij->i", tangent[:-1], tangent[1:])
    line = (np.asarray(segments.curvature) == 0.0) & (lengths > SAME)
    corner = line[:-1] & line[1:] & (np.abs(cosine) < 1.0 - STRAIGHT)
    middle = 0.5 * np.minimum(lengths[:-1], lengths[1:])
    # An arc that begins d before a corner of a small angle passes it at d angle / 4.
    angle = np.arccos(np.clip(cosine, -1.0, 1.0))
    near = np.minimum(4.0 * rounding / np.maximum(angle, STRAIGHT), middle)
    near = np.where(near >= np.minimum(MIN_CUT, middle), near, 0.0)
    cut = np.where(corner, np.maximum(np.minimum(blend, middle), near), 0.0)
    cut = np.concatenate([[0.0], cut, [0.0]])  # at the start of segment i, and at its end
    return _stack_segments(_join_segments(segments, cut))


def _stack_segments(rows: Iterable[_Segments]) -> _Segments:
    return _Segments(*(np.array(column) for column in zip(*rows, strict=True)))


def _join_segments(segments: _Segments, cut: Array) -> Iterable[_Segments]:
    """Yield each segment without its cut ends, and the arc to the next one where it is cut."""
    count = len(cut) - 1
    every = [_Segments(*(column[i] for column in segments)) for i in range(count)]
    for i, segment in enumerate(every):
        length = float(segment.distance)
        rest = length - cut[i] - cut[i + 1]
        if rest == length:
            yield segment
            continue
        if rest > SAME:
            yield segment._replace(
                p0=segment.p0 + cut[i] * segment.tangent,
                R0=pin.exp3(cut[i] / length * segment.turn) @ segment.R0,
                distance=np.asarray(rest),
                turn=rest / length * segment.turn,
            )
        if cut[i + 1] > 0.0:
            yield _make_corner(segment, every[i + 1], float(cut[i + 1]))


def _make_corner(segment: _Segments, onward: _Segments, cut: float) -> _Segments:
    """Return the arc from a line to the next, from `cut` before their corner to `cut` after it."""
    cosine = float(segment.tangent @ onward.tangent)
    sine = float(np.linalg.norm(np.cross(segment.tangent, onward.tangent)))
    angle = math.atan2(sine, cosine)
    radius = cut / math.tan(0.5 * angle)
    normal = onward.tangent - cosine * segment.tangent
    R = pin.exp3((1.0 - cut / float(segment.distance)) * segment.turn) @ segment.R0
    R_after = pin.exp3(cut / float(onward.distance) * onward.turn) @ onward.R0
    return _Segments(
        p0=segment.p0 + (float(segment.distance) - cut) * segment.tangent,
        R0=R,
        distance=np.asarray(radius * angle),
        tangent=segment.tangent,
        normal=normal / np.linalg.norm(normal),
        curvature=np.asarray(1.0 / radius),
        turn=pin.log3(R_after @ R.T),
    )


def _find_circle(a: Array, b: Array, c: Array) -> tuple[Array, Array] | None:
    """Return center and axis of the circle through three points in this order; None of a line."""
    ab, ac = b - a, c - a
    across = np.cross(ab, ac)
    twice_area = float(np.linalg.norm(across))
    longest = max(float(np.linalg.norm(side)) for side in (ab, ac, c - b))
    if twice_area <= STRAIGHT * longest**2:
        return None
    to_center = (ac @ ac) * np.cross(across, ab) + (ab @ ab) * np.cross(ac, across)
    return a + to_center / (2.0 * twice_area**2), across / twice_area
