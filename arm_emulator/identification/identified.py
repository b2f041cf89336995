"""From a record to numbers: looked over, fitted by torques and, if asked, by free runs."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from arm_emulator.identification.filtered import Filtered
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
