"""Identify a scene's numbers from measured motion."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from cyclopts import Parameter
from rich.console import Console
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
from rich.table import Table

from arm_emulator.base.config_files import find_scene
from arm_emulator.base.refusal import Refusal
from arm_emulator.base.warning import given
from arm_emulator.cli.command import command
from arm_emulator.cli.options import SceneName
from arm_emulator.cli.output import output, plain
from arm_emulator.identification import inertia
from arm_emulator.identification.fitted_scene import with_followers, write_fitted
from arm_emulator.identification.found import Found, bodies_of, numbers_found
from arm_emulator.identification.free_run_fit import fit_free_runs
from arm_emulator.identification.measured_run import MeasuredRun
from arm_emulator.identification.picture import draw_torques
from arm_emulator.identification.plausibility import check_fit, looked_over
from arm_emulator.identification.read_run import read_run
from arm_emulator.identification.torque_fit import TorqueFit, explained, fit_torques
from arm_emulator.identification.torque_model import TorqueModel, matches
from arm_emulator.identification.wind_up import wind_up
from arm_emulator.machine.chain import Array
from arm_emulator.machine.scene import Scene, load_scene

DELAYED = ("tau", "q_link")
LONGEST_DELAY = 0.1  # s
FAR = 3.0  # prior deviations, beyond which a number is doubted


@command(
    keys=(
        "`record`, `samples`, `period`, `rows`, `explained`, `directions`, `numbers`, `scene`, "
        "`picture`"
    ),
)
def identify(
    scene: SceneName,
    data: Path,
    /,
    *,
    fit: Annotated[str, Parameter(metavar="NAMES")] = "*",
    hold: Annotated[str, Parameter(metavar="NAMES")] = "",
    out: Annotated[Path, Parameter(metavar="SCENE")] = Path("fitted.yaml"),
    angles: Literal["rad", "deg"] = "rad",
    side: Literal["link", "motor"] = "link",
    delay: Annotated[list[str] | None, Parameter(metavar="SIGNAL=S ...")] = None,
    low_pass: Annotated[float, Parameter(metavar="HZ")] = 10.0,
    trust: float = 0.5,
    as_is: bool = False,
    simulate: bool = False,
) -> int:
    """Find a scene's numbers from a record of its machine's motion.

    Args:
        scene: scene file or name: the nominal machine.
        data: record: .npz, .csv, or a bag's folder.
        fit: numbers to identify, separated by commas.
        hold: numbers to keep, separated by commas.
        out: the scene to write.
        angles: unit in the data.
        side: of the gear on which motor angles are measured.
        delay: delays of tau or q_link.
        low_pass: cut-off frequency.
        trust: relative accuracy of the scene's inertias and springs.
        as_is: skip the check of axes, signs and units.
        simulate: second stage: fit simulated free runs (compiles).
    """
    if not 0.0 < trust <= 10.0:
        raise Refusal("identify", "--trust", "be > 0 and <= 10", trust)
    file = find_scene(scene)
    nominal = load_scene(file)
    if out.suffix != ".yaml":
        raise Refusal("identify", "--out", "end in .yaml", out)
    if out.resolve() == file.resolve():
        raise Refusal("identify", "--out", "be another file than the scene", out)
    console = output.console(110)
    wanted, kept = ([one for one in names.split(",") if one] for names in (fit, hold))
    columns = TextColumn("{task.description}"), SpinnerColumn(), TimeElapsedColumn()
    progress = Console(stderr=True)  # not for JSON, and erased at the end
    with Progress(
        *columns, console=progress, transient=True, disable=not progress.is_terminal
    ) as bar:
        task = bar.add_task("read", total=None)
        late = _delays(delay or ())
        if data.is_dir():
            from arm_emulator.bags.bag_run import read_bag_run  # ROS, where it is needed

            run = read_bag_run(data, nominal).shifted(late)
        else:
            run = read_run(data, nominal, angles, side).shifted(late)
        bar.update(task, description="look the record over")
        run, motion, doubts = looked_over(nominal, run, low_pass, as_is=as_is)
        bar.update(task, description="fit torques")
        typical = motion.tau.std(axis=0), np.abs(motion.v).max(axis=0)
        model = TorqueModel(nominal, typical, trust)
        gears = [f"joints.{joint.name}.gear.stiffness" for joint in nominal.joints]
        fitted = model.choose([one for one in wanted if not _any(gears, one)], "identify")
        fitted = fitted & ~np.array([matches(one.name, kept) for one in model.unknowns])
        torques = model.of(motion)
        found = fit_torques(model, motion, fitted, torques)
        check_fit(run.where, run.joints, found.explained)
        if simulate:
            bar.update(task, description="compile, fit by simulating")
            found = fit_free_runs(found, nominal, run, bar.console.print)
            share = explained(motion.tau, torques.torques(found.values) - motion.tau, motion.moving)
            found = dataclasses.replace(found, explained=share)
        bar.update(task, description="write")
        numbers = numbers_found(nominal, found)
        doubts += _doubts(nominal, found, numbers)
        _write(out, file, nominal, found, numbers, doubts, data.name)
        # Gears wind up under the load of the fitted links.
        springs = [one for one in gears if matches(one, wanted)]
        numbers += _stiffness(load_scene(out), run, springs, kept)
        console.print(_heading(run, late, low_pass, motion.t, found))
        console.print(_table(numbers))
        for doubt in doubts:
            console.print(f"warning: {doubt}", markup=False, highlight=False)
        _write(out, file, nominal, found, numbers, doubts, data.name)
        picture = out.with_suffix(".png")
        title = f"{data.name}: torques at the links, below {low_pass:g} Hz"
        draw_torques(motion, torques.torques(found.values), nominal.joint_names, picture, title)
    console.print(f"scene: {out}\npicture: {picture}")
    given.extend(doubts)
    output.facts(
        {
            "record": run.where,
            "samples": len(run.t),
            "period": run.period,
            "rows": len(motion.t),
            "explained": dict(zip(nominal.joint_names, found.explained, strict=True)),
            "directions": found.directions,
            "numbers": [{**plain(one), "remark": one.remark} for one in numbers],
            "scene": out,
            "picture": picture,
        }
    )
    return 0


def _any(names: Sequence[str], pattern: str) -> bool:
    return any(matches(name, [pattern]) for name in names) and "gear" in pattern


def _delays(given: Sequence[str]) -> dict[str, float]:
    delays = dict[str, float]()
    for one in given:
        name, sign, text = one.partition("=")
        try:
            value = float(text)
        except ValueError:
            value = np.nan
        if name not in DELAYED or not sign or not abs(value) <= LONGEST_DELAY:
            rule = f"be {' or '.join(DELAYED)}=SECONDS, at most {LONGEST_DELAY:g}"
            raise Refusal("identify", "--delay", rule, one)
        delays[name] = value
    return delays


def _stiffness(scene: Scene, run: MeasuredRun, wanted: Sequence[str],
               hold: Sequence[str]) -> list[Found]:  # fmt: skip
    """Return the stiffness of gears whose links have encoders."""
    if run.q_link is None or not wanted:
        return []
    of = wind_up(run, scene)
    numbers = []
    for j, joint in enumerate(scene.joints):
        name, before = f"joints.{joint.name}.gear.stiffness", joint.gear.stiffness
        if before is None or name not in wanted or matches(name, hold):
            continue
        reported = bool(np.isfinite(of.stiffness[j]))
        value = float(of.stiffness[j]) if reported else before
        numbers.append(Found(name, "N m/rad", before, value, float(of.deviation[j]), reported))
    return numbers


def _heading(run: MeasuredRun, delays: dict[str, float], low_pass: float, t: Array,
             fit: TorqueFit) -> str:  # fmt: skip
    late = ", ".join(f"{name} {1e3 * value:g} ms late" for name, value in delays.items())
    explained = ", ".join(f"{share:.1f}" for share in fit.explained)
    return (
        f"{run.where}: {len(run.t)} samples every {1e3 * run.period:g} ms; "
        f"{late or 'no delays taken out'}; low-pass {low_pass:g} Hz both ways (Butterworth, order "
        f"4), {len(t)} rows used\n"
        f"torque explained in motion: {explained} %\n"
        f"{int(fit.fitted.sum())} numbers looked for; the motion has {fit.directions} "
        "combinations of them, the rest is as uncertain as before"
    )


def _table(numbers: Sequence[Found]) -> Table:
    table = Table(title="Found, with standard deviations")
    for heading, side in (("number", "left"), ("unit", "left"), ("before", "right"),
                          ("found", "right"), ("+-", "right"), ("", "left")):  # fmt: skip
        table.add_column(heading, justify=side, no_wrap=True)  # type: ignore[arg-type]
    for one in numbers:
        table.add_row(
            one.name, one.unit, f"{one.before:.5g}", f"{one.value:.5g}", f"{one.deviation:.2g}",
            one.remark,
        )  # fmt: skip
    return table


def _doubts(scene: Scene, fit: TorqueFit, numbers: Sequence[Found]) -> list[str]:
    """Return objections to the numbers found, as text."""
    names, doubts = scene.joint_names, list[str]()
    for of, body in zip(scene.chain.links, scene.bare, strict=True):
        if not inertia.is_body(body):
            doubts.append(f"links.{of.link}: no body has its inertia; the scene's number is kept")
    for effect in fit.effects:
        joints = ", ".join(names[j] for j in effect.joints)
        if len(effect.joints) == len(names) > 1:
            joints = "all joints"
        size = f", by {effect.size:.3g} {effect.unit}" if effect.unit else ""
        doubts.append(
            f"{joints}: {effect.name}{size}: {100.0 * effect.share:.0f} % of what the scene does "
            "not explain; deviations have in them what this may hide"
        )
    for joint, count in zip(names, fit.far_out, strict=True):
        if count:
            doubts.append(f"{joint}: {count} rows stand out, and count little")
    for one in numbers:
        if one.identified and one.far > FAR:
            doubts.append(
                f"{one.name}: {one.value:.4g} {one.unit} is {one.far:.1f} of the deviations known "
                f"before from {one.before:.4g}; is the record in the units and scale given?"
            )
        if one.left:
            doubts.append(f"{one.name}: {one.left}")
    return doubts


def _write(out: Path, file: Path, scene: Scene, fit: TorqueFit, numbers: Sequence[Found],
           doubts: Sequence[str], record: str) -> None:  # fmt: skip
    values = {one.name: one.value for one in numbers if one.name.startswith("joints.")}
    values = {name: value for name, value in values.items() if "measured_torque" not in name}
    heading = [f"Made of {scene.where} by `arm_emulator identify`, of the record {record}.", ""]
    heading += [one.line for one in numbers]
    heading += [f"warning: {doubt}" for doubt in doubts]
    values = with_followers(scene, values)
    write_fitted(out, file, scene, values, bodies_of(scene, fit), "\n".join(heading))
