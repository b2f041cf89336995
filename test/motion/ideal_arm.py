"""An arm that follows its targets exactly, for tests of orders."""

import dataclasses
import math
from typing import Any

import numpy as np

from arm_emulator import Pose, load_gains
from arm_emulator.base.io.config_files import find_scene
from arm_emulator.motion.executor.motion_executor import MotionExecutor
from arm_emulator.motion.model.joint_reference import JointSetpoint
from arm_emulator.motion.trajectory.joint_trajectory import TrajectoryPoint
from arm_emulator.runs.offline import load_offline_run

SECOND = 1_000_000_000


class Ideal:
    """An arm that is where it was asked to be, one motion period after the other."""

    def __init__(self, scene: str = "ur5") -> None:
        run = load_offline_run(scene)
        self.controller, self.start = run.controller, run.session.scene.start
        # Motion of the links; with `full` the servo would get that of the motors.
        motion = load_gains(find_scene(scene)).motion
        self.config = dataclasses.replace(motion, feedforward="torque")
        self.instructor = MotionExecutor(self.config)
        self.period_ns = round(self.config.period * SECOND)
        self.now_ns, self.q = 0, self.start
        self.printed: list[JointSetpoint] = []

    def advance(self, seconds: float) -> None:
        for _ in range(math.ceil(seconds * SECOND / self.period_ns)):
            instruction = self.instructor.compute_setpoint(self.controller, self.now_ns, self.q)
            self.printed.append(instruction)
            v = np.zeros_like(instruction.q) if instruction.v is None else instruction.v
            self.q = instruction.q + self.period_ns / SECOND * v
            self.now_ns += self.period_ns

    def pose(self, shift: Any = (0.0, 0.0, 0.0)) -> Pose:
        R, p = self.controller.kinematics.forward(self.start)
        return Pose(p + np.array(shift), R)

    def states(self) -> list[tuple[str, int, str]]:
        return [(r.kind.name, r.number, r.state.name) for r in self.instructor.reports.waiting]

    def point(self, seconds: float, shift: float, **more: Any) -> TrajectoryPoint:
        return TrajectoryPoint(round(seconds * SECOND), self.start + shift, **more)

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(self.controller.kinematics.joint_names)
