"""From a record to numbers: looked over, fitted by torques and, if asked, by free runs."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from arm_emulator.identification import inertia
from arm_emulator.identification.filtered import Filtered
from arm_emulator.identification.found import Found
from arm_emulator.identification.free_run_fit import fit_free_runs
from arm_emulator.identification.measured_run import MeasuredRun
from arm_emulator.identification.plausibility import check_fit, looked_over
from arm_emulator.identification.torque_fit import TorqueFit, explained, fit_torques
from arm_emulator.identification.torque_model import TorqueModel, matches
from arm_emulator.machine.chain import Array
from arm_emulator.machine.scene import Scene


@dataclass(frozen=True)
class Asked:
    """Numbers to identify, and the way to do so.

    Attributes:
        fit, hold: patterns of numbers to identify, and to keep.
        low_pass: cut-off frequency [Hz].
        trust: relative accuracy of the scene's inertias and springs.
        as_is: skip the check of axes, signs and units.
        simulate: second stage, which fits simulated free runs.
    """

    fit: Sequence[str]
    hold: Sequence[str]
    low_pass: float
    trust: float
    as_is: bool
    simulate: bool


@dataclass(frozen=True)
class Identified:
    """Result of a record.

    Attributes:
        run: the record, without outliers.
        motion: its filtered motion, K rows.
        fit: the numbers.
        torques: at the links, as they explain them (K, N) [N m or N].
        doubts: about the record.
    """

    run: MeasuredRun
    motion: Filtered
    fit: TorqueFit
    torques: Array
    doubts: list[str]


def gears_of(scene: Scene) -> list[str]:
    """Return the names of the gears' stiffnesses, which encoders at the links show, not torques."""
    return [f"joints.{joint.name}.gear.stiffness" for joint in scene.joints]


def identified(
    nominal: Scene,
    record: MeasuredRun,
    asked: Asked,
    stage: Callable[[str], None],
    note: Callable[[str], None],
) -> Identified:
    """Return the numbers with which a scene explains a record.

    Args:
        nominal: the scene.
        record: as it was measured.
        asked: what is sought.
        stage: hears of each stage when it begins.
        note: hears of the progress of free runs.

    Raises:
        Refusal: the record is not one of this machine, or there is nothing to identify.
    """
    stage("look the record over")
    run, motion, doubts = looked_over(nominal, record, asked.low_pass, as_is=asked.as_is)
    stage("fit torques")
    typical = motion.tau.std(axis=0), np.abs(motion.v).max(axis=0)
    model = TorqueModel(nominal, typical, asked.trust)
    gears = gears_of(nominal)
    by_torques = [one for one in asked.fit if not _of_gears(gears, one)]
    fitted = model.choose(by_torques, "identify")
    fitted = fitted & ~np.array([matches(one.name, asked.hold) for one in model.unknowns])
    torques = model.of(motion)
    fit = fit_torques(model, motion, fitted, torques)
    check_fit(run.where, run.joints, fit.explained)
    if asked.simulate:
        stage("compile, fit by simulating")
        fit = fit_free_runs(fit, nominal, run, note)
        error = torques.torques(fit.values) - motion.tau
        fit = dataclasses.replace(fit, explained=explained(motion.tau, error, motion.moving))
    return Identified(run, motion, fit, torques.torques(fit.values), doubts)


def _of_gears(gears: Sequence[str], pattern: str) -> bool:
    return any(matches(name, [pattern]) for name in gears) and "gear" in pattern


FAR = 3.0  # prior deviations, beyond which a number is doubted


def doubts_of(scene: Scene, fit: TorqueFit, numbers: Sequence[Found]) -> list[str]:
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


def draw_torques(data: Filtered, torques: Array, names: tuple[str, ...], file: Path,
                 title: str) -> None:  # fmt: skip
    """Draw measured torques, those of the fit, and their difference."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    N = len(names)
    figure, axes = plt.subplots(
        N, 1, figsize=(10, 1.7 * N + 0.6), sharex=True, squeeze=False, layout="constrained"
    )
    for j, (one, name) in enumerate(zip(axes[:, 0], names, strict=True)):
        moving = np.where(data.moving[:, j], 1.0, np.nan)
        one.plot(data.t, data.tau[:, j], color="0.6", lw=1.0, label="measured")
        one.plot(data.t, torques[:, j] * moving, "C0", lw=1.2, label="computed, in motion")
        one.plot(data.t, (data.tau - torques)[:, j] * moving, "C3", lw=0.8, label="residual")
        one.set_ylabel(f"{name}\nN m")
        one.grid(alpha=0.3)
    axes[0, 0].set_title(title)
    axes[0, 0].legend(fontsize="small", ncols=3)
    axes[-1, 0].set_xlabel("s")
    file.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(file, dpi=100)
    plt.close(figure)
