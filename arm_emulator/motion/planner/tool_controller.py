"""Interface of all methods of motion control, and their choice by a configuration."""

from collections.abc import Sequence
from pathlib import Path
from typing import Protocol

import numpy.typing as npt

from arm_emulator.base.arrays import Array
from arm_emulator.base.calibration.calibration import correct_urdf
from arm_emulator.base.refusal import Refusal
from arm_emulator.motion.model.config import MotionConfig
from arm_emulator.motion.model.drive_parameters import SECTION
from arm_emulator.motion.model.joint_reference import JointSetpoint, Reference
from arm_emulator.motion.model.kinematics import Kinematics
from arm_emulator.motion.model.pose import Pose
from arm_emulator.motion.planner.collision_guard import CollisionGuard
from arm_emulator.motion.planner.jacobian_controller import JacobianController
from arm_emulator.motion.planner.target_planner import TargetPlanner


class Controller(Protocol):
    """A control law that brings an arm's tool to its target, one instruction per motion period.

    Attributes:
        kinematics: of the arm.
        error: tool error that the last `update` found, (rows,) [m, rad]; NaN before any.
        notices: limits of the last `update`, as text; empty: none.
        path_text: kind of the way to the target and its reason, as text; empty: unknown.
    """

    kinematics: Kinematics
    error: Array
    notices: tuple[str, ...]
    path_text: str

    @property
    def coming(self) -> Reference | None:
        """Commanded motion of the joints at the next motion period; None: unknown."""

    @property
    def is_resting(self) -> bool:
        """Whether the law has ended, so that only the machine has to follow."""

    @property
    def is_searching(self) -> bool:
        """Whether it still searches a way to its target."""

    def begin(self, q: npt.ArrayLike, v: npt.ArrayLike | None = None) -> None:
        """Begin at joint angles q (N,), with joint speeds v (N,); None: at rest."""

    def begin_moving(self, now: Reference) -> None:
        """Begin with the joints' commanded motion."""

    def update(self, q: npt.ArrayLike, target: Pose) -> JointSetpoint:
        """Return the joint targets of this motion period, from the measured joint angles (N,)."""

    def retune(self, config: MotionConfig) -> None:
        """Continue with other parameters."""


def make_controller(urdf_xml: str, joint_names: Sequence[str], config: MotionConfig) -> Controller:
    """Return the control law of a configuration.

    Raises:
        Refusal: a description, name or value that is not taken.
    """
    if config.calibration:
        urdf_xml = correct_urdf(urdf_xml, Path(config.calibration), config.tool)
    kinematics = Kinematics(urdf_xml, joint_names, config.tool, config.task, config.where)
    for name in config.drives:
        if name not in kinematics.joint_names:
            joints = ", ".join(kinematics.joint_names)
            raise Refusal(config.where, f"{SECTION}.{name}", "be a joint of the arm", name, joints)
    config.design_shaper()  # refuses one without modes
    if config.has_collision_stop:
        CollisionGuard(kinematics, config)  # refuses shapes that cannot be read
    if config.method == "way":
        return TargetPlanner(kinematics, config)
    return JacobianController(kinematics, config.weight, config.step_limit, config.singular_below)
