"""Machine, servo and motion controller coupled in one process: lock-step without a network.

The three do in every tick what their nodes do in lock-step, in the same order and with the same
numbers, so that the motor states are the same to the last bit.
"""

from __future__ import annotations

import math
import sys
import time

import numpy as np
import numpy.typing as npt

from analysis.servo_loop import warn_of_loops
from arm_emulator.gains import check_fit, load_gains
from arm_emulator.run_report import tell, ticks_of
from arm_emulator.servo_step import ServoStep
from emulator_node.firmware_loop import FirmwareLoop
from emulator_node.plant import Diverged
from emulator_node.scene import Scene, load_scene
from emulator_node.session import Session
from motion_controller_node.controller import controller_for
from motion_controller_node.instruction import Instruction
from motion_controller_node.instructor import Instructor
from motion_controller_node.kinematics import moving_joints
from motion_controller_node.motion_config import MotionConfig
from motion_controller_node.pose import Pose
from servo_node.drives import Drives, Target
from servo_node.servo_config import ServoConfig
from words.bound import Bound
from words.config_files import find_scene
from words.count import check_count
from words.joint_order import JointOrder

FloatArray = npt.NDArray[np.float64]


class OfflineRun:
    """One run from tick 0.

    Attributes:
        session: the machine; tick, logical time, state, energy.
        drives: the servo.
        controller: the control law for the arm.
        instructor: takes tool targets, joint trajectories and tool paths.
        motion_ticks: servo periods in a motion period.

    Args:
        scene: the machine.
        servo: as the node `servo` gets it.
        motion: as the node `motion_controller` gets it.

    Raises:
        Refusal: periods or joints that do not fit together.
    """

    def __init__(self, scene: Scene, servo: ServoConfig, motion: MotionConfig) -> None:
        check_fit(scene, servo, motion)
        self.session = Session(scene, "lockstep", "first_answer")
        self.drives = Drives(servo)
        self.controller = controller_for(scene.urdf, moving_joints(scene.urdf), motion)
        self.instructor = Instructor(motion)
        self.motion_ticks = round(motion.period / servo.period)
        # Indices of one side's joints in the other's arrays; a slice where the order is the same.
        places = _places("servo", scene.joint_names, servo.joint_names)
        names = self.controller.kinematics.joint_names
        self._to_motion = _index(_places("joint_states", servo.joint_names, names))
        self._from_motion = _index(_places("joint_targets", names, servo.joint_names))
        self._step = ServoStep(self.drives, places)
        session = self.session
        self._loop = FirmwareLoop(
            session.plant, session.period_ns, self._step.step, self._step.with_
        )

    def advance(self, ticks: int) -> None:
        """Advance by so many servo periods.

        Raises:
            Refusal: no such count.
            Diverged: the machine did; it stays at the last state before.
        """
        check_count("OfflineRun.advance", "ticks", ticks)
        session, end = self.session, self.session.tick + ticks
        while session.tick < end:
            begun = session.tick % self.motion_ticks
            if begun == 0:
                self._instruct()
            session.advance_in(self._loop, min(self.motion_ticks - begun, end - session.tick))
            if session.fault is not None:
                raise session.fault

    def _instruct(self) -> None:
        """Let the motion controller answer what the servo has measured."""
        session, drives = self.session, self.drives
        now = session.logical_ns
        self._step.measure(self._loop, session.tick)
        q = drives.servo.q_measured[self._to_motion]
        v = drives.servo.v_measured[self._to_motion]
        drives.aim(self._target(self.instructor.instruct(self.controller, now, q, v)))

    def _target(self, instruction: Instruction) -> Target:
        """Return joint targets in the servo's order of joints."""
        order = self._from_motion
        return Target(
            instruction.q[order],
            None if instruction.v is None else instruction.v[order],
            None if instruction.tau is None else instruction.tau[order],
        )


def _places(topic: str, given: tuple[str, ...], wanted: tuple[str, ...]) -> list[int]:
    """Return what to index an array in the order `given` with, to get it in the order `wanted`."""
    place = Bound("place", "", math.inf)
    places = JointOrder(topic, wanted).arrange(given, range(len(given)), place)
    return [int(place) for place in places]


def _index(places: list[int]) -> slice | list[int]:
    return slice(None) if places == list(range(len(places))) else places


def load_offline_run(scene_name: str) -> OfflineRun:
    """Return a run of a scene with the gains that belong to it.

    Raises:
        Refusal: a file that is missing or not taken, or gains that do not fit.
    """
    file = find_scene(scene_name)
    scene, gains = load_scene(file), load_gains(file)
    return OfflineRun(scene, gains.servo, gains.motion)


def run(scene_name: str, seconds: float, displacement: list[float] | None) -> int:
    """Run for some logical time with the tool displaced, and print the outcome.

    Args:
        scene_name: scene file or name.
        seconds: of logical time.
        displacement: of the tool in the world (3,) [m]; None: the arm holds where it starts.
    """
    one = load_offline_run(scene_name)
    session, kinematics = one.session, one.controller.kinematics
    scene = session.scene
    warn_of_loops(scene, one.drives.servo.config)
    ticks = ticks_of(seconds, scene)
    R_WT, p_WT = kinematics.forward(scene.start)
    # By way of the quaternion, as in a message: the rotation has the same rounding then.
    orientation = Pose(p_WT, R_WT).quaternion()
    target = Pose.from_quaternion(
        p_WT + np.array(displacement or (0.0, 0.0, 0.0)), orientation, "run: displacement"
    )
    if displacement is not None:
        one.instructor.add(0, target)
    started = time.perf_counter()
    try:
        one.advance(ticks)
    except Diverged as fault:
        print(fault, file=sys.stderr)
        return 1
    wall = time.perf_counter() - started
    tell(session, ticks, wall, target.p_WT - kinematics.forward(session.state.q)[1])
    return 0
