"""`arm_emulator run`: a machine under our control, or under a table of targets; no network."""

from __future__ import annotations

import contextlib
import math
import signal
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from arm_emulator.analysis.scene_warnings import warn_of_scene
from arm_emulator.analysis.servo_loop import warn_of_loops
from arm_emulator.analysis.stability import explain
from arm_emulator.base.config_files import find_scene
from arm_emulator.base.kept import NOTHING, Kept
from arm_emulator.base.refusal import Refusal
from arm_emulator.base.warning import given
from arm_emulator.build.c_header import CData
from arm_emulator.cli.output import Output
from arm_emulator.machine.diverged import Diverged
from arm_emulator.machine.scene import Scene
from arm_emulator.machine.session import END_OF_TIME, Session
from arm_emulator.motion.pose import Pose
from arm_emulator.runs.gains import load_gains
from arm_emulator.runs.guarded import guarded
from arm_emulator.runs.offline import load_offline_run
from arm_emulator.runs.recorder import Recorder
from arm_emulator.runs.table_run import TableRun, load_table_run, off_target
from arm_emulator.runs.target_table import TargetTable


def run(
    scene_name: str,
    seconds: float,
    displacement: Sequence[float] | None,
    kept: Kept = NOTHING,
    *,
    json: bool = False,
) -> int:
    """Run for some logical time with the tool displaced, and print the outcome.

    Args:
        scene_name: scene file or name.
        seconds: of logical time.
        displacement: of the tool in the world (3,) [m]; None: the arm holds its start.
        kept: record and viewer.
        json: whether to print JSON.
    """
    output = Output(json)
    one = load_offline_run(scene_name)
    session, kinematics = one.session, one.controller.kinematics
    scene = session.scene
    warn_of_loops(scene, one.drives.servo.config)
    ticks = ticks_of(seconds, scene)
    R_WT, p_WT = kinematics.forward(scene.start)
    # Through the quaternion, as in a message, for the same rounding.
    orientation = Pose(p_WT, R_WT).quaternion()
    target = Pose.from_quaternion(
        p_WT + np.array(displacement or (0.0, 0.0, 0.0)), orientation, "run: displacement"
    )
    if displacement is not None:
        one.instructor.add(0, target)
    with Recorder(session.plant, kept, waits=True, stays=True):
        started = time.perf_counter()
        try:
            one.advance(ticks)
        except Diverged as fault:
            return diverged(fault, session, output)
        wall = time.perf_counter() - started
        report(output, session, ticks, wall, target.p_WT - kinematics.forward(session.state.q)[1])
    return 0


def run_table(
    scene_name: str,
    seconds: float | None,
    table: Path,
    library: Path | None,
    kept: Kept = NOTHING,
    *,
    json: bool = False,
) -> int:
    """Run for some logical time, or for that of the table, and print the outcome.

    Raises:
        Refusal: see `load_table_run`, or the control code ended the process.
    """
    output = Output(json)

    def work(progress: CData | None = None) -> int:
        return _run_table(scene_name, seconds, table, library, kept, output, progress)

    return work() if library is None else guarded(library.name, work)


def _run_table(
    scene_name: str,
    seconds: float | None,
    table: Path,
    library: Path | None,
    kept: Kept,
    output: Output,
    progress: CData | None,
) -> int:
    one, targets = load_table_run(scene_name, table, library, progress)
    scene = one.session.scene
    if library is None:
        warn_of_loops(scene, load_gains(find_scene(scene_name)).servo)
    else:
        warn_of_scene(scene)
    with contextlib.closing(one):
        return _report(one, targets, seconds, kept, output)


def _report(
    one: TableRun, targets: TargetTable, seconds: float | None, kept: Kept, output: Output
) -> int:
    session = one.session
    scene = session.scene
    if seconds is None:
        seconds = targets.seconds or 10.0
    ticks = ticks_of(seconds, scene)
    with Recorder(session.plant, kept, waits=True, stays=True):
        started = time.perf_counter()
        try:
            with ctrl_c_ends_at_once():
                one.advance(ticks)
        except Diverged as fault:
            return diverged(fault, session, output)
        wall = time.perf_counter() - started
        report(output, session, ticks, wall, off_target(session, targets, ticks))
    return 0


@contextlib.contextmanager
def ctrl_c_ends_at_once() -> Iterator[None]:
    """In this block Ctrl-C needs no Python: hanging control code ends, and gdb gets it."""
    before = signal.signal(signal.SIGINT, signal.SIG_DFL)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def ticks_of(seconds: float, scene: Scene) -> int:
    """Return a time as a number of servo periods.

    Raises:
        Refusal: less than one, or beyond the range of logical time.
    """
    period, latest = scene.servo_period, END_OF_TIME / 1e9
    if not (math.isfinite(seconds) and round(seconds / period) >= 1):
        rule = f"be at least the servo period, {period:g} s"
        raise Refusal("run", "seconds", rule, f"{seconds:g}")
    if seconds >= latest:
        raise Refusal("run", "seconds", f"be less than {latest:g} s", f"{seconds:g}")
    return round(seconds / period)


def diverged(fault: Diverged, session: Session, output: Output) -> int:
    """Print that a machine has diverged, and return the exit code."""
    text = explain(fault)
    print(text, file=sys.stderr)
    output.facts({"scene": session.scene.name, "diverged": text, "warnings": given})
    return 1


def report(
    output: Output,
    session: Session,
    ticks: int,
    wall: float,
    off: npt.NDArray[np.float64] | None,
) -> None:
    """Print the outcome of a run.

    Args:
        output: destination.
        session: the machine.
        ticks: servo periods of the run.
        wall: their wall time [s].
        off: target minus tool, in the world (3,) [m]; None: no target.
    """
    scene, logical, energy = session.scene, session.logical_ns / 1e9, session.plant.energy
    output.line(f"scene {scene.name}: {logical:g} s of logical time in {wall:.2f} s")
    output.line(
        f"real-time factor  {logical / wall:.1f}   ({wall / ticks * 1e6:.1f} us per servo period)"
    )
    if off is not None:
        x, y, z = off * 1e3
        output.line(f"tool off by       x {x:+.4f}  y {y:+.4f}  z {z:+.4f} mm")
    output.line(f"energy            {energy:.6g} J")
    output.facts(
        {
            "scene": scene.name,
            "logical_time": logical,
            "wall_time": wall,
            "ticks": ticks,
            "tool_off": off,
            "energy": energy,
            "q": dict(zip(scene.joint_names, session.state.q, strict=True)),
            "diverged": None,
            "warnings": given,
        }
    )
