"""Find the cheapest scheme and step for an error."""

import dataclasses
import math
from pathlib import Path
from typing import Annotated

import numpy as np
from cyclopts import Parameter

from arm_emulator.extension.base import Array, Refusal, check_own, find_scene
from arm_emulator.extension.commands import SceneName, command, output
from arm_emulator.extension.machine import FURTHER_OUTPUT, Diverged, Scene, list_rows, load_scene
from arm_emulator.extension.runs import (
    NANOSECONDS,
    DemoPlan,
    OfflineRun,
    Pose,
    load_gains,
    load_target_table,
)
from arm_emulator_analysis.advice import Advice, Judge, Setting, check_error
from arm_emulator_analysis.advice import find_cheapest_settings as settings_for
from arm_emulator_analysis.integrator_text import write_integrator
from arm_emulator_analysis.judged_motions import FINE, JudgedMotion, list_motions
from arm_emulator_analysis.true_motion import FINEST

SECONDS = 1.0  # of motions, and of the demo after the arm has settled


@command(
    keys=(
        "`scene`, `judged_on`, `error`, `settings` (the cheapest first), `now`, `why_none`; if "
        "one is found `written`"
    ),
)
def find_cheapest_setting(
    scene: SceneName = "three_axis",
    /,
    *,
    error: float = 1e-4,
    motion: Annotated[Path | None, Parameter(metavar="FILE")] = None,
    write: bool = False,
) -> int:
    """Find the cheapest scheme, events and step that keep an error.

    Args:
        error: largest error of a link on the way (rad or m).
        motion: test motion: a bag, or a CSV of commands with t and the joints' names (default: the
            scene's demo and motions of many kinds).
        write: put the result into the scene file.
    """
    console = output.make_console()
    file = find_scene(scene)
    check_error(error)
    if write:
        check_own("advise", file)
    machine = load_scene(file)
    with console.status("leading the arm along motions"):
        motions, about = _collect_motions(machine, file, motion)
    judge = Judge(machine, motions)
    with console.status(f"trying schemes, events and steps on {about}"):
        advice = settings_for(judge, error)
    console.print(f"scene {machine.name}, {about}; wanted: error <= {error:g} rad or m on the way")
    output.add_facts({
        "scene": machine.name, "judged_on": about, "error": error, "settings": advice.settings,
        "now": advice.now, "why_none": advice.why_none,
    })  # fmt: skip
    if not advice.settings:
        console.print(f"no setting keeps it: {advice.why_none}")
        return 1
    best = advice.settings[0]
    _print_advice(advice)
    console.print(_state_accuracy(best, len(motions)))
    events = f", events: {best.method.events}" if best.method.events != "step" else ""
    threads = f"; threads: {best.method.threads}" if machine.threads != best.method.threads else ""
    step = f"scheme: {best.method.scheme}, dt: {best.dt:.6g}{events}"
    console.print(f"cheapest: integrator: {{{step}}}{threads}")
    if write:
        write_integrator(file, best.method, best.dt)
        console.print(f"written into {file}")
    output.add_facts({"written": file if write else None})
    return 0


def _collect_motions(
    scene: Scene, file: Path, commands: Path | None
) -> tuple[list[JudgedMotion], str]:
    """Return the test motions, and their description."""
    if commands is not None:
        rows = read_commands(commands, scene)
        return [
            JudgedMotion(commands.name, rows)
        ], f"{_compute_seconds(scene, rows):g} s of {commands.name}"
    try:
        motions = list_motions(scene, SECONDS)
    except Diverged as fault:
        rule = "move by itself; else give a motion with --motion"
        raise Refusal("advise", scene.where, rule, str(fault).splitlines()[0]) from None
    about = f"{len(motions)} motions of {SECONDS:g} s"
    demo = record_demo_commands(scene, file)
    if demo is None:
        return motions, f"{about} (it has no demo)"
    return [
        *motions,
        JudgedMotion("demo", demo),
    ], f"{about} and {_compute_seconds(scene, demo):g} s of its demo"


def _compute_seconds(scene: Scene, rows: Array) -> float:
    return len(rows) * scene.servo_period


def record_demo_commands(scene: Scene, file: Path) -> Array | None:
    """Return the commands (K, N) of the scene's own demo, a row per servo period.

    Recorded in closed loop, once, on the finely integrated machine. Played back in open loop,
    errors are those of the integration alone, without the controller. None: there is no demo, or it
    diverges.
    """
    fine = dataclasses.replace(
        scene,
        integrator=FINEST.make_integrator(scene, FINE),
        threads=1,
    )
    rows: list[Array] = []
    try:
        gains = load_gains(file)
        plan = DemoPlan.load_plan(file, round(gains.motion.period * NANOSECONDS))
        run = OfflineRun(fine, gains.servo, gains.motion)
    except Refusal:
        return None
    R_WT, p_WT = run.controller.kinematics.forward(scene.start)
    settle = plan.settle_ns / NANOSECONDS
    run.instructor.add(plan.settle_ns, Pose(p_WT + plan.displacement, R_WT))
    try:
        for _ in range(round((settle + SECONDS) / scene.servo_period)):
            run.advance(1)
            rows.append(run.session.measured.applied)
    except Diverged:
        return None
    return np.array(rows)


def _state_accuracy(best: Setting, motions: int) -> str:
    """Return the accuracy of the errors in the table, as text."""
    if math.isinf(best.others):
        return "errors: a bound for the motions that were judged, not for others"
    return (
        f"errors: a bound for the {motions} motions judged; for others of their kinds an estimate, "
        f"with a reserve of {best.others / best.error:.1f}"
    )


def _print_advice(advice: Advice) -> None:
    labels = ["cheapest", *[""] * (len(advice.settings) - 1), "now"]
    rows = list[tuple[str, ...]]()
    for label, setting in zip(labels, [*advice.settings, advice.now], strict=True):
        assert setting is not None, "timed along with the others"
        errors = (f"{x:.2e}" if math.isfinite(x) else "-" for x in (setting.error, setting.others))
        cost = f"{setting.cost * 1e6:.0f}" if math.isfinite(setting.cost) else "diverges"
        rows.append((label, str(setting.method), f"{setting.dt:.6g}", *errors, cost))
    heads = "", "setting", "dt [s]", "error, judged", "others", "us per second"
    output.print_table(heads, rows, left=2)


def read_commands(path: Path, scene: Scene) -> Array:
    """Return commands (K, N) in the scene's order of joints, a row per servo period from tick 0.

    Args:
        path: a bag's folder, whose `motor_states` are read, or a table with `t` and the joints'
            names. A row holds until the next one, in the units of the joints' commands.
        scene: the machine.

    Raises:
        Refusal: the file is missing, joints or servo period differ, or ticks are missing.
    """
    return _read_bag(path, scene) if path.is_dir() else _read_table(path, scene)


def _read_table(path: Path, scene: Scene) -> Array:
    table = load_target_table(path, scene.joint_names)
    ticks = table.compute_ticks(scene.servo_period)
    last = ticks[-1] + (ticks[-1] - ticks[-2] if len(ticks) > 1 else 1)
    rows = np.zeros((last, len(scene.joints)))
    for begin, end, row in zip(ticks, [*ticks[1:], last], table.q, strict=True):
        rows[begin:end] = row
    return rows


def _read_bag(path: Path, scene: Scene) -> Array:
    """Return the commands that the motors got in the last run of a bag."""
    # It needs ROS, which is optional here.
    from arm_emulator.extension.bags import RecordedMachine

    rows = np.array([tick.applied for tick in RecordedMachine.open_run(path, scene).ticks[1:]])
    if not len(rows):
        raise Refusal(str(path), "bag", "have motor_states of two ticks at least", "one")
    further = rows[:, 1:].swapaxes(0, 1)
    for name, values in zip(list_rows(scene)[FURTHER_OUTPUT], further, strict=False):
        if values.any():
            rule = "be 0: motions are judged under the commands alone"
            raise Refusal(str(path), name, rule, "others")
    return np.ascontiguousarray(rows[:, 0])
