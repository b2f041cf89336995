"""`arm_emulator run` with joint targets from a table, and no Python in the loop."""

from functools import partial
from pathlib import Path

import numpy as np

from arm_emulator.base.arrays import Array
from arm_emulator.base.io.config_files import find_scene
from arm_emulator.base.refusal import Refusal
from arm_emulator.base.saved_objects import Saved, SavedObjects
from arm_emulator.base.validation.count import check_count
from arm_emulator.machine.scene.scene import Scene, load_scene
from arm_emulator.machine.session.control_code import ControlCode
from arm_emulator.machine.session.firmware import Firmware
from arm_emulator.machine.session.firmware_loop import FirmwareLoop
from arm_emulator.machine.session.session import Session
from arm_emulator.motion.model.kinematics import Kinematics
from arm_emulator.runs.gains import check_servo, load_gains
from arm_emulator.runs.servo_step import ServoStep
from arm_emulator.runs.target_table import TargetTable, check_targets, load_target_table
from arm_emulator.servo.servo_arm import ServoArm
from arm_emulator.toolchain.c_header import CData

_PIECE = 1000  # ticks after which a call looks whether Ctrl-C was pressed


class TableRun:
    """One run from tick 0 of a machine and control code in C.

    Until the first row of the table the target is where the arm starts.

    Attributes:
        session: the machine.

    Args:
        scene: the machine.
        table: joint targets in the scene's order of joints; None: the control code knows them.
        servo: a library of a user's, a microcontroller with firmware, or our servo.

    Raises:
        Refusal: the control code does not take the scene.
    """

    def __init__(
        self,
        scene: Scene,
        table: TargetTable | None,
        servo: ControlCode,
    ) -> None:
        self.session = session = Session(scene, "lockstep", "first_answer")
        self._servo = servo  # it must not go before the loop
        servo.start_on(session.plant, session.period_ns)
        targets = None if table is None else self._list_targets(table)
        self._loop = FirmwareLoop(session.plant, servo, targets)
        self._saved = SavedObjects()

    def _list_targets(self, table: TargetTable) -> tuple[list[int], Array]:
        """Return the ticks from which on rows hold, and the rows."""
        scene = self.session.scene
        ticks, rows = table.compute_ticks(scene.servo_period), table.q
        if ticks[0] > 0:
            return [0, *ticks], np.vstack([scene.start, rows])
        return ticks, rows

    def restart(self, machine: bytes, table: TargetTable) -> None:
        """Start again at tick 0, with a saved machine and a table; the caller resets the servo.

        Raises:
            Refusal: see `Session.restore`.
        """
        self.session.reset()
        self.session.restore(machine)
        self.set_table(table)

    def set_table(self, table: TargetTable) -> None:
        """Follow another table from the present tick on."""
        self._loop.set_targets(self._list_targets(table))

    def advance(self, ticks: int) -> None:
        """Advance by so many servo periods, or fewer up to a breakpoint.

        Raises:
            Refusal: no such count, or the control code gave a command that is not valid.
            Diverged: the machine did; it stays at the last state before.
            Exception: what `ControlCode.ended` gives.
        """
        check_count("TableRun.advance", "ticks", ticks)
        session = self.session
        for done in range(0, ticks, _PIECE):
            try:
                with self._servo.mark_steps():
                    session.advance_in(self._loop, min(_PIECE, ticks - done))
            except Refusal as no:
                name = self._servo.name
                raise Refusal(
                    f"{name}, tick {session.tick}", no.quantity, no.rule, no.got
                ) from None
            if session.fault is not None:
                raise session.fault
            if self._servo.ended is not None:
                raise self._servo.ended
            if self._loop.is_stopped:
                return

    @property
    def tick(self) -> int:
        """Servo periods since the start."""
        return self.session.tick

    def save(self) -> Saved:
        """Return machine and control code as they are now, for `restore`.

        Raises:
            Refusal: the control code cannot be saved.
        """
        parts = self.session.save(), self._servo.save(), self._loop.save()
        return self._saved.copy_objects(parts)

    def restore(self, saved: Saved) -> None:
        """Go on from the tick at which `save` of this run has returned this, to the last bit.

        Raises:
            Refusal: something else; nothing has changed.
        """
        session, code, loop = self._saved.restore_objects(saved, "TableRun.restore")
        self.session.return_to(session)
        self._servo.restore(code)
        self._loop.restore(loop)

    def close(self) -> None:
        """End a user's library; the run cannot go on."""
        self._servo.close()


def load_table_run(
    scene_name: str, table: Path, library: Path | None, progress: CData | None = None
) -> tuple[TableRun, TargetTable]:
    """Return a run of a scene, and its table.

    Args:
        scene_name: scene file or name.
        table: file of joint targets.
        library: control code; None: our servo with the gains that belong to the scene.
        progress: gets what of the library runs.

    Raises:
        Refusal: a file that is missing or not taken, or gains that do not fit.
    """
    file = find_scene(scene_name)
    scene = load_scene(file)
    targets = load_target_table(table, scene.joint_names, partial(check_targets, scene))
    if library is not None:
        return TableRun(scene, targets, Firmware(library, progress)), targets
    config = load_gains(file).servo
    check_servo(scene, config)
    place = [scene.joint_names.index(name) for name in config.joint_names]
    return TableRun(scene, targets, ServoStep(ServoArm(config), place)), targets


def compute_tool_error(session: Session, q_target: Array) -> Array:
    """Return what the tool lacks to joint targets (N,) [rad or m], in the world (3,) [m]."""
    scene = session.scene
    nominal = Kinematics(scene.urdf, scene.joint_names, scene.tool)
    true = Kinematics(scene.true_urdf, tuple(scene.machine_joints), scene.tool)
    q, _ = session.plant.machine_motion
    return np.asarray(nominal.forward(q_target)[1] - true.forward(q)[1])
