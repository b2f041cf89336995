"""The demo's motion without a network: the same servo and motion controller, called in turn."""

from __future__ import annotations

import dataclasses

import numpy as np

from arm_emulator import Plant, Pose, Scene, Servo, load_gains
from arm_emulator.base.config_files import find_scene
from arm_emulator.demo.demo_plan import NANOSECONDS, DemoPlan
from arm_emulator.motion.controller import controller_for
from arm_emulator.motion.instruction import Instruction
from arm_emulator.servo.servo_config import ServoConfig
from bench.motion import Array


class DemoMotion:
    """The demo of one scene: hold the start until the arm has settled, then go to the target.

    Attributes:
        settle: servo periods until the target holds.
        periods: servo periods in all: settling, and one second.
    """

    def __init__(self, scene: Scene) -> None:
        file = find_scene(scene.name)
        gains = load_gains(file)
        motion, self._config = gains.motion, gains.servo
        plan = DemoPlan.load(file, round(motion.period * NANOSECONDS))
        self._names = scene.joint_names
        self._controller = controller_for(scene.urdf, self._names, motion)
        self._cycle = round(motion.period / scene.servo_period)
        self.settle = round(plan.settle_ns / NANOSECONDS / scene.servo_period)
        self.periods = self.settle + round(1.0 / scene.servo_period)
        R_WT, p_WT = self._controller.kinematics.forward(scene.start)
        self._target = Pose(p_WT + plan.displacement, R_WT)

    def run(self, scene: Scene) -> tuple[Array, Array]:
        """Move the machine of `scene`.

        Returns:
            Link positions at the end of each servo period and the voltages within it,
            (periods, N) each.
        """
        plant, servo = Plant(scene), Servo(self._servo_config(scene))
        steps = scene.steps_per_period
        q = np.empty((self.periods, len(self._names)))
        voltages = np.empty_like(q)
        target = Instruction(scene.start)
        self._controller.begin(scene.start)
        for k in range(self.periods):
            measured = plant.measured
            servo.observe(measured.encoder_counts, measured.current)
            if k >= self.settle and k % self._cycle == 0:
                target = self._controller.update(servo.q_measured, self._target)
            voltages[k] = servo.control(target.q, target.v, target.tau)
            plant.advance(voltages[k], steps)
            q[k] = plant.state.q
        return q, voltages

    def tool(self, q: Array) -> Array:
        """Return the tool's position for each row of link positions, (K, 3) [m]."""
        return np.array([self._controller.kinematics.forward(row)[1] for row in q])

    def _servo_config(self, scene: Scene) -> ServoConfig:
        """Return the servo's parameters, in the scene's order, with the encoders it has."""
        known = {joint.name: joint for joint in self._config.joints}
        joints = tuple(
            dataclasses.replace(
                known[joint.name],
                counts_per_turn=joint.counts_per_turn,
            )
            for joint in scene.joints
        )
        return dataclasses.replace(self._config, joints=joints)
