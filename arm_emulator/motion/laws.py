"""The control laws of one arm, of which one leads."""

from __future__ import annotations

import numpy as np

from arm_emulator.motion.controller import Controller
from arm_emulator.motion.feedforward import Feedforward
from arm_emulator.motion.instruction import FloatArray
from arm_emulator.motion.joint_trajectory import JointLimits
from arm_emulator.motion.kinematics import Kinematics
from arm_emulator.motion.motion_config import MotionConfig
from arm_emulator.motion.qp import QpController
from arm_emulator.motion.tool_path import ToolLimits


class Laws:
    """The control laws for tool targets and for tool paths.

    Paths are followed by the quadratic program, whatever the method for targets is: eq. (6) knows
    no speed.

    Attributes:
        controller: for tool targets.
        config: parameters.
        leading: the one that leads; None: none does.
        period_ns: motion period [ns].
        feedforward: what makes the servo's targets of the links' motion.
    """

    def __init__(self, controller: Controller, config: MotionConfig) -> None:
        self.controller, self.config = controller, config
        self.period_ns = round(config.period * 1e9)
        self._follower = controller if isinstance(controller, QpController) else None
        self.leading: Controller | None = None
        self.feedforward = Feedforward(controller.kinematics, config)

    @property
    def follower(self) -> QpController:
        """The law for tool paths; the same where that is possible."""
        if self._follower is None:
            config = self.config
            self._follower = QpController(
                self.controller.kinematics,
                config.period,
                config.velocity_limit,
                config.acceleration_limit,
            )
        return self._follower

    def retune(self, config: MotionConfig) -> None:
        """Go on with other parameters; `controller` is its owner's to retune."""
        self.config = config
        if self._follower not in (None, self.controller):
            self.follower.retune(config)

    def lead(self, law: Controller, q: FloatArray, v: FloatArray) -> None:
        """Let a law lead from now on; if it did not before it begins at these angles and speeds."""
        if self.leading is not law:
            law.begin(q, v)
            self.leading = law

    def nobody_leads(self) -> None:
        """Let the next law begin anew."""
        self.leading = None


def joint_limits(kinematics: Kinematics, config: MotionConfig) -> JointLimits:
    """Return what joint trajectories are held against."""
    return JointLimits(
        kinematics.lower,
        kinematics.upper,
        kinematics.velocity_limit,
        np.minimum(kinematics.acceleration_limit, config.acceleration_limit),
        kinematics.continuous,
    )


def tool_limits(config: MotionConfig) -> ToolLimits:
    """Return how the tool may go along paths."""
    return ToolLimits(
        config.tool_speed,
        config.tool_turn_speed,
        config.tool_acceleration,
        config.tool_jerk,
        config.period,
    )
