"""`arm_emulator run` with joint targets from a table, and no Python in the loop."""

from __future__ import annotations

import contextlib
import signal
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import numpy.typing as npt

from analysis.scene_warnings import warn_of_scene
from analysis.servo_loop import warn_of_loops
from arm_emulator.gains import check_servo, load_gains
from arm_emulator.guarded import guarded
from arm_emulator.run_report import tell, ticks_of
from arm_emulator.servo_step import ServoStep
from arm_emulator.target_table import TargetTable, load_target_table
from emulator_node.firmware import Doing, Firmware, Progress
from emulator_node.firmware_loop import FirmwareLoop
from emulator_node.plant import Diverged
from emulator_node.scene import Scene, load_scene
from emulator_node.session import Session
from microcontroller.microcontroller import Microcontroller
from motion_controller_node.kinematics import Kinematics
from servo_node.drives import Drives
from words.config_files import find_scene
from words.count import check_count
from words.refusal import Refusal

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
        servo: Firmware | Microcontroller | ServoStep,
    ) -> None:
        self.session = Session(scene, "lockstep", "first_answer")
        self._servo = servo  # it must not go before the loop
        targets = None
        if table is not None:
            ticks, rows = table.ticks(scene.servo_period), table.q
            if ticks[0] > 0:
                ticks, rows = [0, *ticks], np.vstack([scene.start, rows])
            targets = ticks, rows
        session = self.session
        if isinstance(servo, Firmware):
            servo.start(session.plant, session.period_ns)
        stop = servo.stop if isinstance(servo, Microcontroller) else None
        struct = servo.progress.loop if isinstance(servo, Firmware) else None
        self._loop = FirmwareLoop(
            session.plant, session.period_ns, servo.step, servo.with_, targets, stop, struct
        )

    def advance(self, ticks: int) -> None:
        """Advance by so many servo periods.

        Raises:
            Refusal: no such count, or the control code gave a command that is none.
            Diverged: the machine did; it stays at the last state before.
            FirmwareEnd: the firmware of a microcontroller cannot go on.
        """
        check_count("TableRun.advance", "ticks", ticks)
        session = self.session
        for done in range(0, ticks, _PIECE):
            try:
                with self._stepping():
                    session.advance_in(self._loop, min(_PIECE, ticks - done))
            except Refusal as no:
                name = self._servo.name
                raise Refusal(
                    f"{name}, tick {session.tick}", no.quantity, no.rule, no.got
                ) from None
            if session.fault is not None:
                raise session.fault
            if isinstance(self._servo, Microcontroller) and self._servo.ended is not None:
                raise self._servo.ended

    def close(self) -> None:
        """End a user's library; the run cannot go on."""
        if isinstance(self._servo, Firmware):
            self._servo.close()

    @contextlib.contextmanager
    def _stepping(self) -> Iterator[None]:
        """Within, whoever watches a user's library knows that it is in its steps."""
        if not isinstance(self._servo, Firmware):
            yield
            return
        progress = self._servo.progress
        progress.doing = Doing.STEP
        try:
            yield
        finally:
            progress.doing = Doing.OURS


def load_table_run(
    scene_name: str, table: Path, library: Path | None, progress: Progress | None = None
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
    targets = load_target_table(table, scene.joint_names)
    if library is not None:
        warn_of_scene(scene)
        return TableRun(scene, targets, Firmware(library, progress)), targets
    config = load_gains(file).servo
    check_servo(scene, config)
    warn_of_loops(scene, config)
    place = [scene.joint_names.index(name) for name in config.joint_names]
    return TableRun(scene, targets, ServoStep(Drives(config), place)), targets


def run(scene_name: str, seconds: float | None, table: Path, library: Path | None) -> int:
    """Run for some logical time, or for that of the table, and print the outcome.

    Raises:
        Refusal: see `load_table_run`, or the control code ended the process.
    """

    def work(progress: Progress | None = None) -> int:
        return _run(scene_name, seconds, table, library, progress)

    return work() if library is None else guarded(library.name, work)


def _run(
    scene_name: str,
    seconds: float | None,
    table: Path,
    library: Path | None,
    progress: Progress | None,
) -> int:
    one, targets = load_table_run(scene_name, table, library, progress)
    with contextlib.closing(one):
        return _report(one, targets, seconds)


def _report(one: TableRun, targets: TargetTable, seconds: float | None) -> int:
    session = one.session
    scene = session.scene
    if seconds is None:
        seconds = targets.seconds or 10.0
    ticks = ticks_of(seconds, scene)
    started = time.perf_counter()
    try:
        with ctrl_c_ends_at_once():
            one.advance(ticks)
    except Diverged as fault:
        print(fault, file=sys.stderr)
        return 1
    wall = time.perf_counter() - started
    tell(session, ticks, wall, off_target(session, targets, ticks))
    return 0


def off_target(session: Session, targets: TargetTable, ticks: int) -> npt.NDArray[np.float64]:
    """Return what the tool lacks to its target after so many ticks, in the world (3,) [m]."""
    scene = session.scene
    at = sum(tick < ticks for tick in targets.ticks(scene.servo_period))
    forward = Kinematics(scene.urdf, scene.joint_names, scene.tool).forward
    wanted = forward(targets.q[at - 1] if at else scene.start)[1]
    return np.asarray(wanted - forward(session.state.q)[1])


@contextlib.contextmanager
def ctrl_c_ends_at_once() -> Iterator[None]:
    """Within, Ctrl-C needs no Python: control code that never returns ends, and gdb gets it."""
    before = signal.signal(signal.SIGINT, signal.SIG_DFL)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
