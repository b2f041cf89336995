"""Run machine, servo and motion controller without a network, as fast as possible."""

import contextlib
import sys
import time
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from arm_emulator.analysis.servo_loop import warn_of_loops
from arm_emulator.analysis.stability import explain_divergence
from arm_emulator.base.io.config_files import find_scene
from arm_emulator.base.packages import find_page_entry
from arm_emulator.base.refusal import Refusal
from arm_emulator.base.run_outputs import NOTHING, RunOutputs
from arm_emulator.base.warning import issued, print_warnings
from arm_emulator.cli.command import command
from arm_emulator.cli.new_bag import check_new_bag
from arm_emulator.cli.options import Keep, PageAt, SceneName, Seconds, TargetFile
from arm_emulator.cli.output import output
from arm_emulator.cli.run_report import count_ticks, end_at_ctrl_c, report_run
from arm_emulator.machine.plant.diverged import Diverged
from arm_emulator.machine.session.session import Session
from arm_emulator.runs.gains import load_gains
from arm_emulator.runs.goal import find_last_target, find_missed_order, find_missed_target
from arm_emulator.runs.guarded import run_guarded
from arm_emulator.runs.offline import load_offline_run
from arm_emulator.runs.order import NO_VECTOR, MoveTool
from arm_emulator.runs.recorder import Recorder, get_viewer_command
from arm_emulator.runs.table_run import TableRun, compute_tool_error, load_table_run
from arm_emulator.runs.target_table import TargetTable
from arm_emulator.runs.timeline import Timeline
from arm_emulator.toolchain.c_header import CData


@command(
    keys=(
        "`scene`, `arithmetic` (version of the rounding), `logical_time`, `wall_time`, `ticks`, "
        "`tool_off`, `energy`, `q`, `diverged`, "
        "`missed` (why the goal was not reached)"
    ),
)
def run_scene(
    scene: SceneName = "three_axis",
    /,
    *,
    seconds: Seconds = None,
    displacement: Annotated[tuple[float, float, float] | None, Parameter(metavar="X Y Z")] = None,
    targets: TargetFile = None,
    servo: Annotated[Path | None, Parameter(metavar="LIBRARY")] = None,
    page: PageAt = None,
    bag: Annotated[Path | None, Parameter(metavar="FOLDER")] = None,
    outputs: Keep = NOTHING,
) -> int:
    """Run machine, servo and motion controller in one process, in lock-step.

    The exit code is 1 where the goal is not reached at the end: the displaced tool by the measure
    of motion control, the last row of a table, or else the start, within 0.01 rad of each joint.

    Args:
        displacement: displacement of the tool from its start (m, in the world; default: none).
        targets: joint targets instead of the motion controller: CSV with t and the joints' names.
        servo: control code in C instead of our servo; with --targets.
        page: serve a page with the run afterwards, until Ctrl-C: [HOST:]PORT (0: any that is free).
        bag: new bag with the run, from any moment of which `fork` leads on; needs ROS 2.
    """
    outputs.check_options("run")
    if targets is not None:
        for option, value in (("--displacement", displacement), ("--page", page), ("--bag", bag)):
            if value is not None:
                raise Refusal("run", option, "stand without --targets", "both")
        return _run_table(scene, seconds, targets, servo, outputs)
    if servo is not None:
        raise Refusal("run", "--servo", "come with --targets, a table of joint targets", "none")
    # A missing package is refused before the run.
    serve = None if page is None else find_page_entry("run").load()
    if bag is not None:
        check_new_bag("run", bag)
    offline = load_offline_run(scene)
    session = offline.session
    machine = session.scene
    warn_of_loops(machine, offline.drives.servo.config)
    ticks = count_ticks(10.0 if seconds is None else seconds, machine)
    move = MoveTool(displacement or NO_VECTOR)
    target = move.target(offline)
    line = None if page is None and bag is None else Timeline(offline)
    if displacement is not None:
        move(offline) if line is None else move.give(line)
    with Recorder(session.plant, outputs, waits=True, stays=True):
        started = time.perf_counter()
        try:
            (line or offline).advance(ticks)
        except Diverged as fault:
            return _report_divergence(fault, session)
        wall = time.perf_counter() - started
        report_run(session, ticks, wall, target.p_WT - offline.true_tool[1])
    missed = (
        find_missed_order(offline) if displacement else find_missed_target(session, machine.start)
    )
    code = output.report_miss("run", missed)
    _name_viewer(outputs)
    if line is not None and bag is not None:
        from arm_emulator.bags.timeline_bag import write_timeline

        write_timeline(line, bag)
        output.print_line(f"bag               {bag}")
    if line is not None and serve is not None:
        serve(line, page)
    return code


def _run_table(
    scene: str, seconds: float | None, table: Path, library: Path | None, outputs: RunOutputs
) -> int:
    """Run for some logical time, or for that of the table, and print the outcome."""

    def run_rows(progress: CData | None = None) -> tuple[int, dict[str, object], list[str]]:
        table_run, targets = load_table_run(scene, table, library, progress)
        if library is None:
            warn_of_loops(table_run.session.scene, load_gains(find_scene(scene)).servo)
        else:
            print_warnings(*table_run.session.scene.warnings)
        with contextlib.closing(table_run):
            return _report_table(table_run, targets, seconds, outputs), output.collected, issued

    if library is None:
        return run_rows()[0]
    code, collected, issued[:] = run_guarded(library.name, run_rows)  # of another process
    output.add_facts(collected)
    return code


def _report_table(
    table_run: TableRun, targets: TargetTable, seconds: float | None, outputs: RunOutputs
) -> int:
    session = table_run.session
    ticks = count_ticks((targets.seconds or 10.0) if seconds is None else seconds, session.scene)
    with Recorder(session.plant, outputs, waits=True, stays=True):
        started = time.perf_counter()
        try:
            with end_at_ctrl_c():
                table_run.advance(ticks)
        except Diverged as fault:
            return _report_divergence(fault, session)
        wall = time.perf_counter() - started
        q_target = find_last_target(session.scene, targets, ticks)
        report_run(session, ticks, wall, compute_tool_error(session, q_target))
    _name_viewer(outputs)
    return output.report_miss("run", find_missed_target(session, q_target))


def _name_viewer(outputs: RunOutputs) -> None:
    """Print the command that shows the recording of Rerun, where one was written."""
    if outputs.rerun is not None and not outputs.is_port:
        output.print_line(f"moving arm        {get_viewer_command(str(outputs.rerun))}")


def _report_divergence(fault: Diverged, session: Session) -> int:
    """Print that a machine has diverged, and return the exit code."""
    text = explain_divergence(fault)
    print(text, file=sys.stderr)
    output.add_facts({"scene": session.scene.name, "diverged": text})
    return 1
