"""The control laws of one arm, of which one leads."""

import numpy as np

from arm_emulator.motion.executor.feedforward import Feedforward
from arm_emulator.motion.executor.shaped_reference import ShapedReference
from arm_emulator.motion.model.config import MotionConfig
from arm_emulator.motion.model.kinematics import Kinematics
from arm_emulator.motion.planner.collision_guard import CollisionGuard
from arm_emulator.motion.planner.target_planner import ACCELERATION_SHARE, TargetPlanner
from arm_emulator.motion.planner.tool_controller import Controller
from arm_emulator.motion.trajectory.jerk_limited_velocity import JerkLimitedVelocity
from arm_emulator.motion.trajectory.joint_trajectory import JointLimits
from arm_emulator.motion.trajectory.tool_path import ToolLimits

_MAX_MARGIN = 0.1  # of a joint's range: a gripper that slides 25 mm has some left
RISE = 0.05  # s, in which jogged joints take up their largest acceleration


class Controllers:
    """The control laws for tool targets and for tool paths.

    Paths are followed along ways that are planned before they begin, whatever the method for
    targets is: eq. (6) knows no speed.

    Attributes:
        controller: for tool targets.
        config: parameters.
        leading: the control law that leads, or None.
        period_ns: motion period [ns].
        guard: stops the arm before parts touch; None: nobody watches.
        shaped: shapes that motion first, so that the arm does not shake.
        feedforward: what makes the servo's targets of the links' motion.
    """

    def __init__(self, controller: Controller, config: MotionConfig) -> None:
        self.controller, self.config = controller, config
        self.period_ns = round(config.period * 1e9)
        self._planner = controller if isinstance(controller, TargetPlanner) else None
        self.leading: Controller | None = None
        self._braking: JerkLimitedVelocity | None = None
        self.shaped = ShapedReference(config.design_shaper(), config.period)
        self.feedforward = Feedforward(controller.kinematics, config)
        has_stop = config.has_collision_stop
        self.guard = CollisionGuard(controller.kinematics, config) if has_stop else None
        if self._planner is not None:
            self._planner.guard = self.guard

    @property
    def planner(self) -> TargetPlanner:
        """The law for tool paths; the same if possible."""
        if self._planner is None:
            self._planner = TargetPlanner(self.controller.kinematics, self.config)
        return self._planner

    @property
    def braking(self) -> JerkLimitedVelocity:
        """Braking motion before a collision."""
        kinematics, config = self.controller.kinematics, self.config
        if self._braking is None:
            self._braking = make_jerk_limited_velocity(kinematics, config, 0.0, ACCELERATION_SHARE)
        return self._braking

    def set_parameters(self, config: MotionConfig) -> None:
        """Continue with other parameters; its owner retunes `controller`."""
        self.config, self._braking = config, None
        self.shaped.set_shaper(config.design_shaper())
        if self._planner not in (None, self.controller):
            self.planner.retune(config)


def make_joint_limits(kinematics: Kinematics, config: MotionConfig) -> JointLimits:
    """Return the limits of joint trajectories."""
    speed = np.minimum(kinematics.velocity_limit, config.velocity_limit)
    if config.trajectory_limits == "scale":
        speed = np.full_like(speed, np.inf)  # what is faster takes longer
    return JointLimits(
        kinematics.lower,
        kinematics.upper,
        speed,
        np.minimum(kinematics.acceleration_limit, config.acceleration_limit),
        kinematics.continuous,
    )


def make_jerk_limited_velocity(
    kinematics: Kinematics, config: MotionConfig, margin: float, share: float = 1.0
) -> JerkLimitedVelocity:
    """Return joints that reach speeds, and come to rest, as in jogs and before collisions.

    They stop at a margin before their limits [rad or m], `_MAX_MARGIN` of their range at most, and
    use a share of the largest acceleration.
    """
    limits = make_joint_limits(kinematics, config)
    acceleration = share * limits.acceleration
    within = np.minimum(margin, _MAX_MARGIN * (limits.upper - limits.lower))
    return JerkLimitedVelocity(
        limits.lower + within,
        limits.upper - within,
        np.minimum(limits.speed, config.velocity_limit),
        acceleration,
        acceleration / RISE,
        config.period,
    )


def make_tool_limits(config: MotionConfig) -> ToolLimits:
    """Return the tool's limits along paths."""
    return ToolLimits(
        config.tool_speed,
        config.tool_turn_speed,
        config.tool_acceleration,
        config.tool_jerk,
    )
