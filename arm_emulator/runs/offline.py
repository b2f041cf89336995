"""Machine, servo and motion controller coupled in one process: lock-step without a network.

In every tick the three compute as their nodes do in lock-step, in the same order and with the same
numbers. The motor states are therefore the same to the last bit.
"""

import math
from functools import cached_property
from pathlib import Path

from arm_emulator.base.arrays import Array
from arm_emulator.base.io.config_files import find_scene
from arm_emulator.base.non_copyable import NonCopyable
from arm_emulator.base.refusal import Refusal
from arm_emulator.base.saved_objects import Saved, SavedObjects
from arm_emulator.base.validation.count import check_count
from arm_emulator.base.validation.joint_order import JointOrder
from arm_emulator.base.validation.number import Number
from arm_emulator.machine.scene.scene import Scene, coerce_scene, load_scene
from arm_emulator.machine.session.firmware_loop import FirmwareLoop
from arm_emulator.machine.session.session import Session
from arm_emulator.motion.executor.motion_executor import MotionExecutor
from arm_emulator.motion.model.config import MotionConfig
from arm_emulator.motion.model.joint_reference import JointSetpoint
from arm_emulator.motion.model.kinematics import Kinematics, list_moving_joints
from arm_emulator.motion.planner.tool_controller import make_controller
from arm_emulator.runs.gains import check_fit, load_gains
from arm_emulator.runs.servo_step import ServoStep
from arm_emulator.runs.true_kinematics import find_true_kinematics
from arm_emulator.servo.servo_arm import ServoArm, Target
from arm_emulator.servo.servo_config import ServoConfig


class OfflineRun(NonCopyable):
    """One run from tick 0.

    Attributes:
        session: the machine; tick, logical time, state, energy.
        drives: the servo.
        controller: the control law for the arm.
        instructor: takes tool targets, joint trajectories and tool paths.
        motion_ticks: servo periods in a motion period.
        aimed: joint targets that the servo got last, in its order of joints (N,) [rad or m].

    Args:
        scene: the machine, or what `load_scene` takes: a name or a file.
        servo: of `load_gains`, as the node `servo` gets it.
        motion: likewise for the node `motion_controller`.

    Raises:
        Refusal: other types than these, or periods or joints that do not fit together.
    """

    instead = "a new one, or `fork` of a `Timeline`"

    def __init__(self, scene: Scene | str | Path, servo: ServoConfig, motion: MotionConfig) -> None:
        scene = coerce_scene(scene, "OfflineRun")
        for name, config, kind in (("servo", servo, ServoConfig), ("motion", motion, MotionConfig)):
            if not isinstance(config, kind):
                raise Refusal("OfflineRun", name, "be that of `load_gains`", config)
        check_fit(scene, servo, motion)
        self.session = Session(scene, "lockstep", "first_answer")
        self.drives = ServoArm(servo)
        self.controller = make_controller(scene.urdf, list_moving_joints(scene.urdf), motion)
        self.instructor = MotionExecutor(motion)
        self.aimed = scene.start
        self._saved = SavedObjects()
        self._motion = motion
        self.motion_ticks = round(motion.period / servo.period)
        # Indices of one side's joints in the other's arrays; a slice where the order is the same.
        places = _find_places("servo", scene.joint_names, servo.joint_names)
        names = self.controller.kinematics.joint_names
        self._to_motion = _index_places(_find_places("joint_states", servo.joint_names, names))
        self._from_motion = _index_places(_find_places("joint_targets", names, servo.joint_names))
        self._step = ServoStep(self.drives, places)
        session = self.session
        self._loop = FirmwareLoop(session.plant, self._step)

    @cached_property
    def true_kinematics(self) -> Kinematics:
        """Kinematics of the machine, which may differ from the controller's."""
        return find_true_kinematics(self.session.scene, self.controller.kinematics)

    @property
    def true_tool(self) -> tuple[Array, Array]:
        """Rotation (3, 3) and position (3,) [m] of the machine's tool in the world now."""
        names, plant = list(self.session.scene.machine_joints), self.session.plant
        places = [names.index(name) for name in self.true_kinematics.joint_names]
        return self.true_kinematics.forward(plant.machine_motion[0][places])

    def __repr__(self) -> str:
        return f"<OfflineRun of {self.session.scene.name} at tick {self.session.tick}>"

    def advance(self, ticks: int) -> None:
        """Advance by so many servo periods, or fewer up to a breakpoint.

        Raises:
            Refusal: no such count.
            Diverged: the machine did; it stays at the last state before.
        """
        check_count("OfflineRun.advance", "ticks", ticks)
        session, end = self.session, self.session.tick + ticks
        while session.tick < end:
            begun = session.tick % self.motion_ticks
            if begun == 0:
                self._instruct_servo()
            session.advance_in(self._loop, min(self.motion_ticks - begun, end - session.tick))
            if session.fault is not None:
                raise session.fault
            if self._loop.is_stopped:
                return

    def restart(self, machine: bytes) -> None:
        """Start again at tick 0, with a saved machine; gains and limits stay as they are.

        Raises:
            Refusal: see `Session.restore`.
        """
        self.session.reset()
        self.session.restore(machine)
        self.drives.reset()
        self.instructor = MotionExecutor(self._motion)

    @property
    def tick(self) -> int:
        """Servo periods since the start."""
        return self.session.tick

    def save(self) -> Saved:
        """Return machine, servo and motion controller as they are now, for `restore`."""
        parts = self.session.save(), self._step.save(), self.controller, self.instructor
        return self._saved.copy_objects((*parts, self.aimed, self._motion))

    def restore(self, saved: Saved) -> None:
        """Go on from the tick at which `save` of this run has returned this, to the last bit.

        Controller and instructor are others than before: take them from the run again.

        Raises:
            Refusal: something else; nothing has changed.
        """
        session, step, *others = self._saved.restore_objects(saved, "OfflineRun.restore")
        self.session.return_to(session)
        self._step.restore(step)
        self.controller, self.instructor, self.aimed, self._motion = others

    @property
    def wind_up(self) -> Array:
        """By how much the motion controller takes the gears to be wound up (N,) [rad or m]."""
        order = self._from_motion
        return self.instructor.wind_up[order]

    def _instruct_servo(self) -> None:
        """Let the motion controller answer what the servo has measured."""
        session, drives = self.session, self.drives
        now = session.logical_ns
        self._step.take_measurement(session.plant)
        q = drives.servo.q_measured[self._to_motion]
        v = drives.servo.v_measured[self._to_motion]
        tau = drives.servo.tau_measured[self._to_motion]
        can = drives.movable(session.powered)[self._to_motion]
        target = self._make_target(
            self.instructor.compute_setpoint(self.controller, now, q, v, can, tau)
        )
        self.aimed = target.q
        drives.set_target(target)

    def _make_target(self, instruction: JointSetpoint) -> Target:
        """Return joint targets in the servo's order of joints."""
        order = self._from_motion
        return Target(
            instruction.q[order],
            None if instruction.v is None else instruction.v[order],
            None if instruction.tau is None else instruction.tau[order],
        )


def _find_places(topic: str, names: tuple[str, ...], targets: tuple[str, ...]) -> list[int]:
    """Return what to index an array in the order `names` with, to get it in the order `targets`."""
    place = Number.bound_size("place", "", math.inf)
    places = JointOrder(topic, targets).arrange_values(names, range(len(names)), place)
    return [int(place) for place in places]


def _index_places(places: list[int]) -> slice | list[int]:
    return slice(None) if places == list(range(len(places))) else places


def load_offline_run(scene_name: str) -> OfflineRun:
    """Return a run of a scene with the gains that belong to it.

    Raises:
        Refusal: a file that is missing or not taken, or gains that do not fit.
    """
    file = find_scene(scene_name)
    scene, gains = load_scene(file), load_gains(file)
    return OfflineRun(scene, gains.servo, gains.motion)
