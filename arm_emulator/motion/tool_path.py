"""Tool paths: poses in a row, and the curve through them with the places where the tool stops.

The tool first goes to the first pose from where it is, and rests in it. Then it follows the curve
of tool_curve.py, as fast as limits of the tool and of the joints allow, or so that it is in each
pose at the time that the pose is stamped with.

Flat corners are rounded, so that the tool passes them no farther than `ROUNDED` away. Where the
direction still steps the tool stops: no joint can change its speed at once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from arm_emulator.base.refusal import Refusal
from arm_emulator.motion.pose import Pose
from arm_emulator.motion.tool_curve import SAME, ToolCurve

WHERE = "tool_path"
MOST_POSES = 5000
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
        self.times_ns = None if times_ns is None else _in_order(times_ns, len(poses))
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
        sharp = self.curve.kinks() > SHARP if len(self.curve) > 1 else np.zeros(0, dtype=bool)
        self.stops = ends[np.concatenate([[True], sharp, [len(self.curve) > 0]])[: len(ends)]]

    @property
    def first(self) -> Pose:
        """Its first pose."""
        return self.poses[0]

    def place(self, x: float) -> str:
        """Return the place of a measure x [m] on the path as text."""
        at = self.curve.at_poses * (self.curve.ends[-1] / max(self.curve.at_poses[-1], SAME))
        k = int(np.clip(np.searchsorted(at, x + SAME, side="right") - 1, 0, len(self.poses) - 1))
        return f"{max(0.0, x - at[k]):.3g} m after poses[{k}]"


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
