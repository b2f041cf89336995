"""Joint targets from a CSV file with columns `t` and the joints, and limits that they exceed."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from arm_emulator.base.arrays import Array
from arm_emulator.base.io.table_file import Table, read_table
from arm_emulator.base.refusal import Refusal
from arm_emulator.base.validation.bound import POSITION
from arm_emulator.base.warning import print_warnings
from arm_emulator.machine.scene.scene import Scene
from arm_emulator.motion.model.kinematics import Kinematics
from arm_emulator.motion.trajectory.joint_trajectory import ROUNDING, SPEED_BETWEEN_POINTS

RowCheck = Callable[[str, Sequence[str], Array, Array], None]

LATEST = 1e9  # s
_ROUNDING = 1e-6  # of a period: a time that was written with a few digits is that of its tick


@dataclass(frozen=True)
class TargetTable:
    """Joint targets that hold from their time until the next one's.

    Attributes:
        t: times, ascending (K,) [s].
        q: in the order of the joints that were asked for (K, N) [rad or m].
    """

    t: npt.NDArray[np.float64]
    q: npt.NDArray[np.float64]

    @property
    def seconds(self) -> float | None:
        """Its duration, with a last row as long as the previous one; None: it has one row."""
        return float(2.0 * self.t[-1] - self.t[-2]) if len(self.t) > 1 else None

    def compute_ticks(self, period: float) -> list[int]:
        """Return the tick from which on each row holds: the first one not before its time."""
        return [math.ceil(t / period - _ROUNDING) for t in self.t.tolist()]


def load_target_table(
    file: Path, joint_names: Sequence[str], check: RowCheck | None = None
) -> TargetTable:
    """Read a table.

    Args:
        file: the CSV file.
        joint_names: joints of its columns, in the order of the result.
        check: refuses targets beyond an arm's limits, given the file's name, the names of the rows,
            and times and targets in that order; None: the numbers are no targets of an arm.

    Raises:
        Refusal: no such file; other columns; a row with a gap; a value that is no number or too
            large; times that do not ascend from 0 s or later; what `check` refuses.
    """
    names = ["t", *joint_names]
    units = {name: "rad or m" for name in joint_names} | {"t": "s"}
    table = read_table(file, units)
    if sorted(table.columns) != sorted(names):
        rule = "be t and every joint of the scene once"
        actual = ", ".join(table.columns) or "none"
        raise Refusal(table.where, "columns", rule, actual, ", ".join(names))
    numbers = table.values[:, [table.columns.index(name) for name in names]]
    if not len(numbers):
        raise Refusal(table.where, "table", "have a row of targets", "none")
    _check_table(numbers, table, names)
    if check is not None:
        check(table.where, [f"line {line}" for line in table.lines], numbers[:, 0], numbers[:, 1:])
    return TargetTable(numbers[:, 0], numbers[:, 1:])


def _check_table(numbers: Array, table: Table, names: Sequence[str]) -> None:
    """Refuse gaps, times that do not ascend and angles that are not finite, with their lines."""
    t, q = numbers[:, 0], numbers[:, 1:]
    for row, column in np.argwhere(np.isnan(numbers))[:1]:
        cell = f"line {table.lines[row]}, {names[column]}"
        unit = "rad or m" if column else "s"
        raise Refusal(table.where, cell, f"be a number [{unit}]", "nothing")
    for row in np.flatnonzero((t < 0.0) | (t > LATEST))[:1]:
        rule = f"be from 0 to {LATEST:g} s"
        raise Refusal(table.where, f"line {table.lines[row]}, t", rule, t[row])
    for row in np.flatnonzero(np.diff(t) <= 0.0)[:1] + 1:
        rule = f"be later than the previous row's, {t[row - 1]:g} s"
        raise Refusal(table.where, f"line {table.lines[row]}, t", rule, f"{t[row]:g} s")
    for row, column in np.argwhere(np.abs(q) > POSITION.most)[:1]:
        rule = f"be within +-{POSITION.most:g} rad or m"
        cell = f"line {table.lines[row]}, {names[column + 1]}"
        raise Refusal(table.where, cell, rule, q[row, column])


DEGREE = math.pi / 180.0
MILLI = 1e-3
REGULAR_SPEED = 1.0  # rad/s, or reaches per second: the largest speed of a joint that states none
_SECONDS_ROWS, _SECONDS_SHARE = 10, 1e-2  # rows at whole seconds, as milliseconds would be
_FAR_TOO_FAST = 5.0  # times the limit: a slip of a unit more probably than a fast motion


def check_targets(scene: Scene, where: str, rows: Sequence[str], t: Array, q: Array) -> None:
    """Refuse targets that leave the joints' limits, as joint trajectories are refused.

    The speed of a row is the mean one from the previous row on. Tables that keep all limits, but
    are probably in degrees or milliseconds, are warned of.

    Args:
        scene: the machine.
        where: of the table.
        rows: name of each row, for refusals.
        t: times (K,) [s].
        q: targets in the scene's order of joints (K, N) [rad or m].

    Raises:
        Refusal: a position beyond the limits, or a mean speed beyond them, with the unit in which
            the numbers probably are.
    """
    arm = Kinematics(scene.urdf, scene.joint_names, scene.tool)
    names, slides = scene.joint_names, arm.joint_scale != 1.0
    for row, j in np.argwhere(_find_outside(arm, q))[:1]:
        unit, probable = _get_units(slides[j])
        scaled = q[:, j] * (MILLI if slides[j] else DEGREE)
        fits = bool(((scaled >= arm.lower[j]) & (scaled <= arm.upper[j])).all())
        rule = f"keep the joint's limits, [{arm.lower[j]:.6g}, {arm.upper[j]:.6g}] {unit}"
        actual = f"{q[row, j]:.6g}" + (f", probably {probable}" if fits else "")
        raise Refusal(where, f"{rows[row]}, {names[j]}", rule, actual)
    _check_speed(where, rows, t, q, arm)
    _warn_of_units(where, t, np.vstack([scene.start, q]), arm)


def keep_limits(scene: Scene, t: Array, q: Array) -> bool:
    """Return whether tables of targets keep the joints' limits, see `check_targets`.

    Args:
        scene: the machine.
        t: times of each table (..., K) [s].
        q: targets in the scene's order of joints (..., K, N) [rad or m].
    """
    arm = Kinematics(scene.urdf, scene.joint_names, scene.tool)
    return not (np.any(_find_outside(arm, q)) or np.any(_find_too_fast(arm, t, q)[0]))


def _find_outside(arm: Kinematics, q: Array) -> npt.NDArray[np.bool_]:
    """Return which targets are beyond the limits of their joints (..., K, N)."""
    return (q < arm.lower - ROUNDING) | (q > arm.upper + ROUNDING)


def _find_too_fast(arm: Kinematics, t: Array, q: Array) -> tuple[npt.NDArray[np.bool_], Array]:
    """Return which mean speeds from row to row are too fast, and these (..., K - 1, N)."""
    v = np.diff(q, axis=-2) / np.diff(t)[..., None]
    return np.abs(v) > SPEED_BETWEEN_POINTS * arm.velocity_limit, v


def _check_speed(where: str, rows: Sequence[str], t: Array, q: Array, arm: Kinematics) -> None:
    limit = arm.velocity_limit
    too_fast, v = _find_too_fast(arm, t, q)
    for row, j in np.argwhere(too_fast)[:1]:
        unit, probable = _get_units(bool(arm.joint_scale[j] != 1.0))
        share = np.abs(v[:, j]).max() / limit[j]
        slip = _FAR_TOO_FAST < share <= 1.0 / (DEGREE if unit == "rad" else MILLI)
        rule = f"keep the joint's limit of speed from the previous row on, {limit[j]:.6g} {unit}/s"
        actual = f"{v[row, j]:.6g} {unit}/s" + (f", probably {probable}" if slip else "")
        raise Refusal(where, f"{rows[row + 1]}, {arm.joint_names[j]}", rule, actual)


def _warn_of_units(where: str, t: Array, q: Array, arm: Kinematics) -> None:
    """Warn of numbers that no limit excludes; `q` begins with the start (K + 1, N)."""
    revolutions = np.ptp(q, axis=0) / (2.0 * math.pi)
    revolutions[arm.joint_scale != 1.0] = 0.0
    if revolutions.size and revolutions.max() > 1.0:
        name = arm.joint_names[int(np.argmax(revolutions))]
        times = f"{revolutions.max():.3g} times"
        print_warnings(f"{where}: {name} turns {times}; targets must be in rad, not degrees")
    regular = np.where(
        np.isfinite(arm.velocity_limit), arm.velocity_limit, arm.joint_scale * REGULAR_SPEED
    )
    share = float(
        np.max(np.abs(np.diff(q[1:], axis=0) / np.diff(t)[:, None]) / regular, initial=0.0)
    )
    in_seconds = len(t) >= _SECONDS_ROWS and bool((t == np.round(t)).all())
    if 0.0 < share <= (_SECONDS_SHARE if in_seconds else MILLI):
        print_warnings(
            f"{where}: no joint moves at more than {100.0 * share:.2g} % of its largest speed; "
            "t must be in s, not ms"
        )


def _get_units(slides: bool) -> tuple[str, str]:
    """Return the unit of a joint, and the other one in which its angles or ways are often given."""
    return ("m", "mm") if slides else ("rad", "degrees")
