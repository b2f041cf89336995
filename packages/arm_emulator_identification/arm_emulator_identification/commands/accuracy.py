"""Measure an arm's accuracy and repeatability by ISO 9283, before and after a calibration."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from cyclopts import Parameter

from arm_emulator.extension.base import Array, Number, Refusal, find_scene
from arm_emulator.extension.commands import SceneName, command, output
from arm_emulator.extension.machine import Scene, find_joint_path, load_scene, parse_urdf
from arm_emulator.extension.runs import load_gains
from arm_emulator_identification.calibration.accuracy import (
    Accuracy,
    AccuracyTest,
    Calibrated,
    measure_accuracy,
)
from arm_emulator_identification.calibration.drawn_deviations import draw_deviations
from arm_emulator_identification.stages import show_stages

CYCLES = Number("--cycles", at_least=2, at_most=10_000, whole=True)
CENTRE = Number.bound_size("--centre", "m", 1e3)
EDGE = Number("--edge", "m", above=0.0, at_most=10.0)
DWELL = Number("--dwell", "s", above=0.0, at_most=100.0)
POSES = Number("--fit", at_least=0, at_most=100_000, whole=True)
CHECK = Number("--held", at_least=0, at_most=100_000, whole=True)
TRACKER = Number("--tracker", "m", above=0.0, at_most=0.1)
TRACKER_ANGLE = Number("--tracker-angle", "rad", above=0.0, at_most=0.1)
SEED = Number("seed", at_least=0, at_most=2**53, whole=True)


@command(
    keys=(
        "`scene`, `edge`, `cycles`, `before` and `after` (`AP`, `RP`, `vAP` and the five `poses`), "
        "`numbers`, `rank`, `alike`, `held` (rms and largest misses `before` and `after`), "
        "`calibration`"
    ),
)
def compare_accuracy(
    scene: SceneName,
    /,
    *,
    cycles: int = 30,
    centre: Annotated[tuple[float, float, float] | None, Parameter(metavar="X Y Z")] = None,
    edge: Annotated[float | None, Parameter(metavar="M")] = None,
    dwell: Annotated[float, Parameter(metavar="S")] = 1.0,
    directions: bool = False,
    draw: Annotated[int | None, Parameter(metavar="SEED")] = None,
    fit: Annotated[int, Parameter(metavar="POSES")] = 0,
    held: Annotated[int, Parameter(metavar="POSES")] = 20,
    tracker: Annotated[float, Parameter(metavar="M")] = 15e-6,
    tracker_angle: Annotated[float, Parameter(metavar="RAD")] = 1.7e-4,
    positions: bool = False,
    seed: int = 0,
    out: Annotated[Path, Parameter(metavar="FILE")] = Path("calibration.yaml"),
) -> int:
    """Measure accuracy and repeatability by ISO 9283, before and after a calibration.

    Args:
        scene: scene file or name.
        cycles: of the five poses.
        centre: of the cube (m, in the world; default: where the tool is at the start).
        edge: of the cube (default: the largest that the arm reaches).
        dwell: time at rest before a pose is measured.
        directions: approach P1, P2 and P4 from three directions too.
        draw: draw the machine's deviations, where the scene has none.
        fit: random poses from which the true kinematics is found.
        held: further poses that judge it.
        tracker: standard deviation of measured positions, per axis.
        tracker_angle: standard deviation of measured turns, per axis.
        positions: measure positions alone.
        seed: of random poses and of the tracker's noise.
        out: the calibration that is found.
    """
    for number, value in ((CYCLES, cycles), (DWELL, dwell), (POSES, fit), (CHECK, held),
                          (TRACKER, tracker), (TRACKER_ANGLE, tracker_angle),
                          (SEED.rename("--seed"), seed)):  # fmt: skip
        number.check_value("accuracy", value)
    if edge is not None:
        EDGE.check_value("accuracy", edge)
    for coordinate in centre or ():
        CENTRE.check_value("accuracy", coordinate)
    if fit and out.suffix != ".yaml":
        raise Refusal("accuracy", "--out", "end in .yaml", out)
    file = find_scene(scene)
    machine, gains = load_scene(file), load_gains(file)
    if draw is not None:
        machine = _draw_deviations(
            machine, file, int(SEED.rename("--draw").check_value("accuracy", draw))
        )
    angle = math.inf if positions else tracker_angle
    test = AccuracyTest(cycles, centre, edge, dwell, directions, fit, held, tracker, angle, seed)
    with show_stages() as stage:
        size, before, calibrated, after = measure_accuracy(machine, gains, test, stage, out)
    output.add_facts({"scene": machine.name, "edge": size, "cycles": cycles})
    console = output.make_console(110)
    console.print(f"{machine.name}: {cycles} cycles of 5 poses in a cube of {size:g} m")
    _print_accuracy("before the calibration" if calibrated else "as it is", "before", before)
    if calibrated is None or after is None:
        return 0
    _print_fit(calibrated, fit, held)
    _print_accuracy("after the calibration", "after", after)
    console.print(f"calibration: {calibrated.file}")
    output.add_facts({"calibration": calibrated.file})
    return 0


def _draw_deviations(scene: Scene, file: Path, seed: int) -> Scene:
    """Return the scene with deviations of the joints to its tool."""
    if scene.calibration.deviations:
        raise Refusal("accuracy", "--draw", "stand with a scene without calibration", scene.where)
    path = find_joint_path(parse_urdf(scene.urdf, scene.where), scene.where, "", scene.tool,
                           scene.tool)  # fmt: skip
    deviations = draw_deviations(path.moving + path.behind[:1], np.random.default_rng(seed))
    joints = {name: deviation.nonzero for name, deviation in deviations.items()}
    return load_scene(file, {"calibration": {"joints": joints}})


def _print_accuracy(title: str, key: str, result: Accuracy) -> None:
    heads = "pose", "AP [mm]", "RP [mm]", "AP, turn [mrad]", "RP, turn [mrad]"
    rows = (
        (f"P{k}", f"{1e3 * pose.AP:.4f}", f"{1e3 * pose.RP:.4f}",
         f"{1e3 * _compute_length(pose.AP_abc):.4f}", f"{1e3 * max(pose.RP_abc):.4f}")
        for k, pose in enumerate(result.poses, start=1)
    )  # fmt: skip
    output.print_table(heads, rows, title=title)
    if result.vAP is not None:
        output.print_line(f"vAP, three directions of approach: {1e3 * result.vAP:.4f} mm")
    poses = [{"AP": pose.AP, "RP": pose.RP, "AP_abc": pose.AP_abc, "RP_abc": pose.RP_abc}
             for pose in result.poses]  # fmt: skip
    output.add_facts({key: {"AP": result.AP, "RP": result.RP, "vAP": result.vAP, "poses": poses}})


def _print_fit(calibrated: Calibrated, poses: int, separate: int) -> None:
    fit = calibrated.fit
    output.print_line(
        f"fit: {fit.count} numbers from {poses} poses; {fit.rank} or combinations of them act alone"
    )
    for name, others in fit.alike.items():
        alike = f"moves the tool as {' with '.join(others)}: cannot be distinguished"
        output.print_line(f"  {name} {alike if others else 'does not move what is measured'}")
    poses_text = f"{separate} held poses" if separate else "the poses of the fit"
    facts: dict[str, Any] = {}
    for key, (off, angles_off) in (("before", calibrated.before), ("after", calibrated.after)):
        facts[key] = {"p": _compute_rms(off), "p_largest": off.max(), "R": _compute_rms(angles_off)}
        output.print_line(
            f"{poses_text}, {key}: {1e3 * _compute_rms(off):.4f} mm rms, "
            f"{1e3 * off.max():.4f} mm at most, {1e3 * _compute_rms(angles_off):.4f} mrad rms"
        )
    output.add_facts({"numbers": fit.count, "rank": fit.rank, "alike": fit.alike, "held": facts})


def _compute_rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _compute_length(values: Sequence[float]) -> float:
    return math.hypot(*values)
