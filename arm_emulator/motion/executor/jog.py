"""Jog commands: speeds of the tool or of joints, and their limits.

Names, units and codes are those of MoveIt Servo. `ToolDirections` makes joint speeds of a twist.
"""

import enum
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from arm_emulator.base.arrays import Array
from arm_emulator.base.refusal import Refusal
from arm_emulator.base.validation.bound import VELOCITY
from arm_emulator.base.validation.joint_order import check_joints_exist
from arm_emulator.motion.model.config import MotionConfig
from arm_emulator.motion.model.kinematics import POSE_ROWS, POSITION_ROWS, Kinematics

UNITLESS = "unitless"
_SPEED = VELOCITY.rename("velocities")
_TWIST = VELOCITY.rename("twist")


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
        """Name of the limit as text."""
        return self.name.lower().replace("_", " ").replace("decelerate", "slower")


@dataclass(frozen=True, eq=False)
class JogCommand:
    """A jog command."""

    time_ns: int
    """Logical time of it [ns]."""
    twist: Array | None = None
    """Speed of the tool, translation and rotation (6,) [m/s, rad/s]."""
    link: str = ""
    """Link along whose axes it is, as they are at each moment; empty: the base."""
    joints: Array | None = None
    """Joint speeds (N,) [rad/s or m/s]."""


def make_twist_command(
    time_ns: int,
    twist: Sequence[float],
    link: str,
    kinematics: Kinematics,
    config: MotionConfig,
) -> JogCommand:
    """Return a command for the tool in m/s and rad/s, within the scales.

    The twist (6,) is along the axes of a link, or of the base if that is empty or ``world``.

    Raises:
        Refusal: an unknown link, numbers that are not finite, or a turn where the task does not
            rule it.
    """
    values = _TWIST.check_row("delta_twist_cmds", twist, POSE_ROWS)
    if not kinematics.has_orientation and values[POSITION_ROWS:].any():
        rule = "be 0 with a task of 3 rows (task: position)"
        raise Refusal("delta_twist_cmds", "twist.angular", rule, values[POSITION_ROWS:].tolist())
    if link in ("world", kinematics.base):
        link = ""
    if link and link not in (*kinematics.links, kinematics.tool):
        rule, valid = "be a link of the robot", ", ".join(kinematics.links)
        raise Refusal("delta_twist_cmds", "header.frame_id", rule, link, valid)
    scales = config.jog_scale_linear, config.jog_scale_rotational
    parts = values[:POSITION_ROWS], values[POSITION_ROWS:]
    if config.jog_command_in_type == UNITLESS:
        both = [scale * part for scale, part in zip(scales, parts, strict=True)]
    else:
        both = [_limit_length(part, scale) for scale, part in zip(scales, parts, strict=True)]
    return JogCommand(time_ns, np.concatenate(both), link)


def make_joint_command(
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
    where, arm_joints = "delta_joint_cmds", kinematics.joint_names
    check_joints_exist(where, names, arm_joints)
    if len(set(names)) != len(names) or not names:
        raise Refusal(where, "joint_names", "name joints, each once", list(names))
    values = _SPEED.check_row(where, velocities, len(names))
    speeds = np.zeros(len(arm_joints))
    scale = config.jog_scale_joint if config.jog_command_in_type == UNITLESS else 1.0
    speeds[[arm_joints.index(name) for name in names]] = scale * values
    return JogCommand(time_ns, None, "", speeds)


def _limit_length(part: Array, size: float) -> Array:
    norm = float(np.linalg.norm(part))
    return part if norm <= size else part * (size / norm)
