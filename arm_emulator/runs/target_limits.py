"""Limits of joints, and slips of units, in tables of joint targets."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from arm_emulator.base.given import FloatArray
from arm_emulator.base.refusal import Refusal
from arm_emulator.base.warning import warn
from arm_emulator.machine.scene import Scene
from arm_emulator.motion.joint_trajectory import ROUNDING, SPEED_BETWEEN_POINTS
from arm_emulator.motion.kinematics import Kinematics

DEGREE = math.pi / 180.0
MILLI = 1e-3
USUAL = 1.0  # rad/s, or reaches per second: the largest speed of a joint that states none
_MANY, _WHOLE_SHARE = 10, 1e-2  # rows at whole seconds, as milliseconds would be
_FAR_TOO_FAST = 5.0  # times the limit: a slip of a unit more probably than a fast motion


def check_targets(
    scene: Scene, where: str, rows: Sequence[str], t: FloatArray, q: FloatArray
) -> None:
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
    outside = (q < arm.lower - ROUNDING) | (q > arm.upper + ROUNDING)
    for row, j in np.argwhere(outside)[:1]:
        unit, probable = _units(slides[j])
        scaled = q[:, j] * (MILLI if slides[j] else DEGREE)
        fits = bool(((scaled >= arm.lower[j]) & (scaled <= arm.upper[j])).all())
        rule = f"keep the joint's limits, [{arm.lower[j]:.6g}, {arm.upper[j]:.6g}] {unit}"
        got = f"{q[row, j]:.6g}" + (f", probably {probable}" if fits else "")
        raise Refusal(where, f"{rows[row]}, {names[j]}", rule, got)
    _check_speed(where, rows, t, q, arm)
    _warn_of_units(where, t, np.vstack([scene.start, q]), arm)


def _check_speed(
    where: str, rows: Sequence[str], t: FloatArray, q: FloatArray, arm: Kinematics
) -> None:
    limit = arm.velocity_limit
    v = np.diff(q, axis=0) / np.diff(t)[:, None]
    for row, j in np.argwhere(np.abs(v) > SPEED_BETWEEN_POINTS * limit)[:1]:
        unit, probable = _units(bool(arm.joint_scale[j] != 1.0))
        share = np.abs(v[:, j]).max() / limit[j]
        slip = _FAR_TOO_FAST < share <= 1.0 / (DEGREE if unit == "rad" else MILLI)
        rule = f"keep the joint's limit of speed from the previous row on, {limit[j]:.6g} {unit}/s"
        got = f"{v[row, j]:.6g} {unit}/s" + (f", probably {probable}" if slip else "")
        raise Refusal(where, f"{rows[row + 1]}, {arm.joint_names[j]}", rule, got)


def _warn_of_units(where: str, t: FloatArray, q: FloatArray, arm: Kinematics) -> None:
    """Warn of numbers that no limit excludes; `q` begins with the start (K + 1, N)."""
    turns = np.ptp(q, axis=0) / (2.0 * math.pi)
    turns[arm.joint_scale != 1.0] = 0.0
    if turns.size and turns.max() > 1.0:
        name = arm.joint_names[int(np.argmax(turns))]
        warn(f"{where}: {name} turns {turns.max():.3g} times; targets must be in rad, not degrees")
    usual = np.where(np.isfinite(arm.velocity_limit), arm.velocity_limit, arm.joint_scale * USUAL)
    share = float(np.max(np.abs(np.diff(q[1:], axis=0) / np.diff(t)[:, None]) / usual, initial=0.0))
    whole = len(t) >= _MANY and bool((t == np.round(t)).all())
    if 0.0 < share <= (_WHOLE_SHARE if whole else MILLI):
        warn(
            f"{where}: no joint moves at more than {100.0 * share:.2g} % of its largest speed; "
            "t must be in s, not ms"
        )


def _units(slides: bool) -> tuple[str, str]:
    """Return the unit of a joint, and the other one in which its angles or ways are often given."""
    return ("m", "mm") if slides else ("rad", "degrees")
