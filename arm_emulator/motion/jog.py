"""Jog commands: speeds of the tool or of joints, and their limits.

Names, units and codes are those of MoveIt Servo. A twist becomes joint speeds by the singular
values s_i of the scaled Jacobian, with its directions u_i in the task and v_i in the joints:

    v = sum_i v_i (u_i' twist) / max(s_i, s_1 / stop)

What leads towards a singular pose by its own lost direction is slowed down from s_1 / slow on and
ends at s_1 / stop; what leads away from it, or past it in other directions, goes on.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from arm_emulator.base.bound import VELOCITY
from arm_emulator.base.refusal import Refusal
from arm_emulator.motion.instruction import FloatArray
from arm_emulator.motion.kinematics import POSE_ROWS, POSITION_ROWS, Kinematics
from arm_emulator.motion.motion_config import MotionConfig

UNITLESS = "unitless"
Brakes = Callable[[FloatArray, float], float]
"""Share of joint speeds (N,) that comes to rest within a time at those speeds [s]."""
_NEAR = 4.0  # times the singular value at which a jog slows down: farther ones are left behind
_PROBE = 0.01  # rad, to find whether a direction leads towards a singular pose
_SIGNIFICANT = 0.05  # part of a twist: a direction with less of it does not slow the rest
_SPEED = VELOCITY.named("velocities")
_TWIST = VELOCITY.named("twist")


class JogStatus(enum.IntEnum):
    """Limits of a jog, by the codes of MoveIt Servo."""

    NO_WARNING = 0
    DECELERATE_FOR_APPROACHING_SINGULARITY = 1
    HALT_FOR_SINGULARITY = 2
    DECELERATE_FOR_LEAVING_SINGULARITY = 3
    DECELERATE_FOR_COLLISION = 4
    HALT_FOR_COLLISION = 5
    JOINT_BOUND = 6

    @property
    def words(self) -> str:
        """The same as text."""
        return self.name.lower().replace("_", " ").replace("decelerate", "slower")


@dataclass(frozen=True, eq=False)
class JogCommand:
    """A jog command."""

    time_ns: int
    """Logical time of it [ns]."""
    twist: FloatArray | None = None
    """Of the tool, translation and rotation (6,) [m/s, rad/s]."""
    of_tool: bool = False
    """Whether it is along the tool's axes; else along those of the base."""
    joints: FloatArray | None = None
    """Joint speeds (N,) [rad/s or m/s]."""


def twist_command(
    time_ns: int,
    twist: Sequence[float],
    of_tool: bool,
    kinematics: Kinematics,
    config: MotionConfig,
) -> JogCommand:
    """Return a command for the tool in m/s and rad/s, within the scales.

    Raises:
        Refusal: numbers that are not finite, or a turn where the task does not rule it.
    """
    given = _TWIST.row("delta_twist_cmds", twist, POSE_ROWS)
    if not kinematics.turns_tool and given[POSITION_ROWS:].any():
        rule = "be 0 with a task of 3 rows (task: position)"
        raise Refusal("delta_twist_cmds", "twist.angular", rule, given[POSITION_ROWS:].tolist())
    scales = config.jog_scale_linear, config.jog_scale_rotational
    parts = given[:POSITION_ROWS], given[POSITION_ROWS:]
    if config.jog_command_in_type == UNITLESS:
        both = [scale * part for scale, part in zip(scales, parts, strict=True)]
    else:
        both = [_at_most(part, scale) for scale, part in zip(scales, parts, strict=True)]
    return JogCommand(time_ns, np.concatenate(both), of_tool)


def joint_command(
    time_ns: int,
    names: Sequence[str],
    velocities: Sequence[float],
    kinematics: Kinematics,
    config: MotionConfig,
) -> JogCommand:
    """Return a command for joints in rad/s or m/s; joints without one rest.

    Raises:
        Refusal: unknown or repeated joints, another number of speeds, or not finite ones.
    """
    where, known = "delta_joint_cmds", kinematics.joint_names
    for name in names:
        if name not in known:
            raise Refusal(where, "joint_names", "be joints of the arm", name, ", ".join(known))
    if len(set(names)) != len(names) or not names:
        raise Refusal(where, "joint_names", "name joints, each once", list(names))
    given = _SPEED.row(where, velocities, len(names))
    speeds = np.zeros(len(known))
    scale = config.jog_scale_joint if config.jog_command_in_type == UNITLESS else 1.0
    speeds[[known.index(name) for name in names]] = scale * given
    return JogCommand(time_ns, None, False, speeds)


def _at_most(part: FloatArray, size: float) -> FloatArray:
    norm = float(np.linalg.norm(part))
    return part if norm <= size else part * (size / norm)


@dataclass(frozen=True, eq=False)
class Speeds:
    """Joint speeds requested, and their permitted share."""

    v: FloatArray
    """(N,) [rad/s or m/s]."""
    status: JogStatus = JogStatus.NO_WARNING


def speeds_of_twist(
    kinematics: Kinematics,
    q: FloatArray,
    twist: FloatArray,
    config: MotionConfig,
    brakes: Brakes | None = None,
) -> Speeds:
    """Return the joint speeds of a twist along the world's axes (6,).

    Args:
        kinematics: of the arm.
        q: joint angles (N,).
        twist: (6,) [m/s, rad/s].
        config: thresholds.
        brakes: what share of joint speeds (N,) can come to rest within a time at them [s]; joints
            that move then rest before a singular pose. None: as quick as need be.
    """
    scale = kinematics.joint_scale
    U, s, V = _directions(kinematics, q)
    wanted = kinematics.scale * twist[: kinematics.rows]
    size = float(np.linalg.norm(wanted))
    parts = U.T @ wanted
    slow = s[0] / config.jog_lower_singularity_threshold
    stop = s[0] / config.jog_hard_stop_singularity_threshold
    whole, status = 1.0, JogStatus.NO_WARNING
    for i in np.flatnonzero(s < slow):
        if abs(parts[i]) < 1e-9 * size or size == 0.0:
            continue
        ahead = q + scale * V[i] * math.copysign(_PROBE, parts[i])
        towards = _directions(kinematics, ahead)[1][i] < s[i]
        left = min(1.0, max(0.0, (s[i] - stop) / (slow - stop))) if towards else 1.0
        if abs(parts[i]) > _SIGNIFICANT * size:
            whole = min(whole, left)
            status = max(status, _singular(towards, left))
        else:
            parts[i] *= left
    v = scale * (V[: len(s)].T @ (parts / np.maximum(s, stop)))
    if brakes is not None and whole > 0.0 and s[-1] < _NEAR * slow:
        used = (np.abs(parts) > _SIGNIFICANT * size) & (s < _NEAR * slow)
        can = _stopping(kinematics, q, v, s, stop, used, brakes)
        if can < whole:
            whole = can
            status = max(status, JogStatus.DECELERATE_FOR_APPROACHING_SINGULARITY)
    return Speeds(whole * v, status)


def _stopping(
    kinematics: Kinematics,
    q: FloatArray,
    v: FloatArray,
    s: FloatArray,
    stop: float,
    used: npt.NDArray[np.bool_],
    brakes: Brakes,
) -> float:
    """Return the share of v (N,) from which no singular value in use falls below `stop`."""
    fastest = float(np.abs(v / kinematics.joint_scale).max())
    if not used.any() or fastest == 0.0:
        return 1.0
    probe = _PROBE / fastest
    falls = (s - _directions(kinematics, q + probe * v)[1])[used] / probe
    if (falls <= 0.0).all():
        return 1.0
    left = np.maximum(s[used] - stop, 0.0)[falls > 0.0] / falls[falls > 0.0]
    return brakes(v, float(left.min()))


def _singular(towards: bool, left: float) -> JogStatus:
    if not towards:
        return JogStatus.DECELERATE_FOR_LEAVING_SINGULARITY
    if left > 0.0:
        return JogStatus.DECELERATE_FOR_APPROACHING_SINGULARITY
    return JogStatus.HALT_FOR_SINGULARITY


def _directions(kinematics: Kinematics, q: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    J = kinematics.scale[:, None] * kinematics.jacobian(q) * kinematics.joint_scale
    try:
        U, s, V = np.linalg.svd(J)
    except np.linalg.LinAlgError:
        raise ArithmeticError("the singular values of the Jacobian cannot be computed") from None
    return U[:, : len(s)], s, V
