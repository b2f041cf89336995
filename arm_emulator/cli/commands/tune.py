"""Compute a servo's gains; margins, steps, encoders."""

import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated

import numpy as np
from cyclopts import Parameter

from arm_emulator.base.io.config_files import check_own, find_beside, find_scene
from arm_emulator.base.refusal import Refusal
from arm_emulator.cli.command import command
from arm_emulator.cli.options import SceneName
from arm_emulator.cli.output import output
from arm_emulator.design.gain_text import write_gains
from arm_emulator.design.tuned import (
    Range,
    Tuned,
    compute_link_inertias,
    compute_servo,
    examine_gains,
    load_without_payload,
)
from arm_emulator.machine.scene.scene import Scene
from arm_emulator.runs.gains import check_joints
from arm_emulator.servo.servo_config import ServoConfig, load_servo_config


@command(keys="`scene`, `joints`, `picture`, `written`")
def tune_scene(
    scene: SceneName = "three_axis",
    /,
    *,
    out: Annotated[Path | None, Parameter(metavar="FOLDER")] = None,
    payload: Annotated[float | None, Parameter(metavar="KG")] = None,
    write: bool = False,
) -> int:
    """Compute gains for a scene, and compare them with the present ones.

    Args:
        out: folder of a picture.
        payload: mass at the tool, instead of the scene's.
        write: write the gains into the servo's file.
    """
    console = output.make_console()
    file = find_scene(scene)
    servo_file = find_beside(file, "servo")
    if write:
        check_own("tune", servo_file)
    machine, without = load_without_payload(file, payload)
    servo = load_servo_config(servo_file)
    _check_scene(machine, servo)
    inertias = compute_link_inertias([machine] if without is None else [machine, without])
    with console.status("computing gains"):
        computed = compute_servo(machine, servo, inertias)
        pair = {
            "present": examine_gains(machine, without, servo),
            "computed": examine_gains(machine, without, computed),
        }
    _print_gains(machine, inertias, pair)
    picture = None
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        picture = out / f"tune_{machine.name}.png"
        draw_gains(machine, pair, picture)
        console.print(f"drawn: {picture}")
    if write:
        write_gains(servo_file, computed)
        console.print(f"written: {servo_file}")
    joints = _list_facts(machine, inertias, pair)
    written = servo_file if write else None
    output.add_facts(
        {"scene": machine.name, "joints": joints, "picture": picture, "written": written}
    )
    return 0


def _list_facts(
    scene: Scene,
    inertias: list[Range],
    pair: Mapping[str, Tuned],
) -> dict[str, dict[str, object]]:
    """Return the values of the tables by joint, in SI units."""
    facts: dict[str, dict[str, object]] = {
        name: {"inertia": inertia}
        for name, inertia in zip(scene.joint_names, inertias, strict=True)
    }
    for label, tuned in pair.items():
        for j, name in enumerate(scene.joint_names):
            loop = tuned.loops.joints[j]
            facts[name][label] = {
                "position_gain": loop.position_gain,
                "velocity_gain": loop.velocity_gain,
                "integral_time": loop.integral_time,
                "observer_bandwidth": loop.observer_bandwidth,
                "margins": tuned.margins[j],
                "margins_without_payload": None if tuned.bare is None else tuned.bare[j],
                "step": tuned.steps[j],
                "off_on_the_way": tuned.run.worst[j],
                "count": loop.count_angle,
                "swing": tuned.run.swing[j],
            }
    return facts


def _check_scene(scene: Scene, servo: ServoConfig) -> None:
    check_joints(scene, servo)
    for joint in scene.joints:
        if joint.motor is None:
            raise Refusal(scene.where, f"joints.{joint.name}", "have a motor to be tuned", "none")


def _print_gains(
    scene: Scene,
    inertias: list[Range],
    pair: Mapping[str, Tuned],
) -> None:
    def list_gains(label: str, j: int) -> Iterator[str]:
        servo_joint = pair[label].loops.joints[j]
        yield f"{inertias[j][0]:.3g} .. {inertias[j][1]:.3g}" if label == "present" else ""
        yield f"{servo_joint.position_gain:.3g}"
        yield f"{servo_joint.velocity_gain:.3g}"
        yield f"{servo_joint.integral_time:.3g}"
        yield f"{servo_joint.observer_bandwidth:.3g}"

    def list_margins(label: str, j: int) -> Iterator[str]:
        m, bare = pair[label].margins[j], pair[label].bare
        yield f"{m.gain_up:.2f}"
        yield f"{math.degrees(m.phase):.0f}"
        yield f"{m.delay:.1f}"
        yield f"{m.sensitivity:.2f}"
        yield "-" if bare is None else f"{bare[j].gain_up:.2f}"
        yield "-" if bare is None else f"{math.degrees(bare[j].phase):.0f}"

    def list_motion(label: str, j: int) -> Iterator[str]:
        step = pair[label].steps[j]
        yield f"{1e3 * step.rise:.0f}"
        yield f"{100.0 * step.overshoot:.0f} %"
        yield f"{1e3 * step.settling:.0f}"
        yield f"{1e3 * pair[label].run.worst[j]:.3f}"

    def list_rest(label: str, j: int) -> Iterator[str]:
        count = pair[label].loops.joints[j].count_angle
        yield f"{1e3 * count:.3g}"
        yield f"{pair[label].run.swing[j] / count:.2f}"

    for cells, title, *columns in (
        (list_gains, "gains",
         "inertia, kg m2", "position, 1/s", "velocity, N m s/rad", "integral, s",
         "observer, rad/s"),
        (list_margins, "margins, worst pose", "gain", "phase, deg", "delay, periods", "sensitivity",
         "without payload: gain", "phase, deg"),
        (list_motion, "step, worst pose; move", "rise, ms", "overshoot", "settled, ms",
         "off on the way, mrad (mm)"),
        (list_rest, "at rest", "a count, mrad (mm)", "swing of the machine, counts"),
    ):  # fmt: skip
        rows = [
            (name if label == "present" else "", label, *cells(label, j))
            for j, name in enumerate(scene.joint_names)
            for label in pair
        ]
        output.print_table(("joint", "gains", *columns), rows, title=title, left=2)


ROWS = 400


def draw_gains(scene: Scene, pair: Mapping[str, Tuned], file: Path) -> None:
    """Draw both sets of gains, the present ones dashed, each joint in a colour of its own."""
    from matplotlib.figure import Figure  # not pyplot: no screen, no global state

    figure = Figure(figsize=(15, 4.5), layout="constrained")
    left, middle, right = figure.subplots(1, 3)
    period = scene.servo_period
    span = max(6.0 / joint.position_gain for tuned in pair.values() for joint in tuned.loops.joints)
    every = max(1, round(span / period / ROWS))
    for label, line in (("present", "--"), ("computed", "-")):
        tuned = pair[label]
        loop = tuned.loops.loops[0]
        w, S = loop.compute_sensitivities()
        for j, name in enumerate(scene.joint_names):
            colour, legend = f"C{j}", name if label == "computed" else None
            q = loop.compute_step_response(j, ROWS, every)[:, j]
            left.plot(1e3 * period * every * np.arange(ROWS), q, line, color=colour, label=legend)
            frequency = w / (2.0 * math.pi * period)
            middle.loglog(frequency, np.abs(S[:, j]), line, color=colour)
            t = period * np.arange(len(tuned.run.off))
            right.plot(t, 1e3 * tuned.run.off[:, j], line, color=colour)
    left.set(title="step of a joint's target", xlabel="ms", ylabel="link / target")
    left.legend(fontsize="small")
    middle.axhline(2.0, color="grey", linewidth=0.8)
    middle.set(
        title="amplification of disturbances",
        xlabel="Hz",
        ylabel="|1 / (1 + L)|",
        ylim=(1e-3, 10.0),
    )
    right.set(title="smooth move: link less target", xlabel="s", ylabel="mrad (mm)")
    for axes in (left, middle, right):
        axes.grid(alpha=0.3)
    figure.suptitle(f"{scene.name} at its start: present gains dashed, computed ones solid")
    figure.savefig(file, dpi=90)
