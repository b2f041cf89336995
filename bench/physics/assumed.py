"""Spread of an arm's demo over the assumed numbers of its scene.

Most figures of motors, gears and friction of the scenes are assumed, each within a range
(bench/physics/origins.py). Here these arms make the demo's motion: the scene's own arm, arms with
one figure at either end of its range, arms with all figures drawn from their ranges. All of them
have the scene's servo and motion controller, which do not know the changed figures.
"""

from __future__ import annotations

import contextlib
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from arm_emulator import Diverged, OfflineRun, Pose, load_gains, load_scene
from arm_emulator.base.arrays import Array
from arm_emulator.base.io.config_files import find_scene
from arm_emulator.demo.demo_plan import DemoPlan
from bench.measure import show_progress
from bench.physics.origins import NumberOrigin, list_origins
from bench.tables import format_table

TITLE = "What is assumed of the arms"

ARMS = ("ur5", "panda")
SAMPLED_ARMS = 24  # arms with all figures drawn
Values = dict[str, float]  # of varied numbers, by name


@dataclass(frozen=True)
class AssumedFigure:
    """A figure that is assumed, and how to give it to the joints that share it."""

    label: str
    joints: tuple[str, ...]
    value: float
    low: float
    high: float
    names: tuple[tuple[str, float], ...]  # numbers that change, and with which power of the figure
    nominal: Values

    def scale_numbers(self, value: float) -> Values:
        """Return the numbers of the joints where the figure is `value`."""
        if self.value == 0.0:
            return {name: value for name, _ in self.names}
        factor = value / self.value
        return {name: self.nominal[name] * factor**power for name, power in self.names}

    def draw_value(self, rng: np.random.Generator) -> float:
        """Return a value from the range: of 2 and 8, 4 is in the middle."""
        if self.low <= 0.0:
            return float(rng.uniform(self.low, self.high))
        return float(np.exp(rng.uniform(np.log(self.low), np.log(self.high))))


def list_assumed(file: Path) -> list[AssumedFigure]:
    """Return what a scene assumes, in the order of the file.

    The torque constant is the constant of the back EMF, too. A gear's ratio is structure, not a
    number of a machine. A ratio changed by r0/r is equal to motors with constants and dry friction
    r0/r times as large. Their rotors are (r0/r)^2 times as heavy and as viscous.
    """
    origin_list = [origin for origin in list_origins(file) if origin.assumed is not None]
    nominal = {name: origin.value for origin in origin_list for name in origin.list_names()}

    def make_figure(origin: NumberOrigin) -> AssumedFigure:
        key = f"{origin.section}.{origin.key}"
        powers = {
            "motor.torque_constant": {"torque_constant": 1.0, "back_emf_constant": 1.0},
            "gear.ratio": {"torque_constant": -1.0, "back_emf_constant": -1.0,
                           "rotor_inertia": -2.0, "friction.coulomb": -1.0,
                           "friction.viscous": -2.0},
        }.get(key)  # fmt: skip
        names = [(name, 1.0) for name in origin.list_names()]
        if powers:
            names = [(name, power) for joint in origin.joints for of_motor, power in powers.items()
                     if (name := f"joints.{joint}.motor.{of_motor}") in nominal]  # fmt: skip
        assert origin.assumed is not None
        return AssumedFigure(
            key, origin.joints, origin.value, *origin.assumed, tuple(names), nominal
        )

    return [make_figure(origin) for origin in origin_list if origin.key != "back_emf_constant"]


def simulate_demos(scene_name: str, arms: list[Values], instructions: int | None = None) -> Array:
    """Return target minus tool of each arm before each instruction (count, K + 1, 3) [m].

    What the demo does, in lock-step and without a network; from where an arm diverges, NaN.

    Args:
        scene_name: scene file or name.
        arms: by which numbers each differs from the scene.
        instructions: K; None: as many as the demo has.
    """
    file = find_scene(scene_name)
    gains = load_gains(file)
    names = sorted({name for arm in arms for name in arm})
    # Numbers that are set later change the machine, not what its current loops know of it.
    scene = load_scene(file, {"varied": names} if names else None)
    residuals = []
    with show_progress(f"{file.stem}, {len(arms)} arms", len(arms)) as done:
        for arm in arms:
            run = OfflineRun(scene, gains.servo, gains.motion)
            for name, value in arm.items():
                run.session.set_varied(name, value)
            residuals.append(make_demo(run, file, instructions))
            done()
    return np.stack(residuals)


def make_demo(run: OfflineRun, file: Path, instructions: int | None) -> Array:
    """Return target minus tool before each instruction (K + 1, 3) [m]; NaN once it diverges."""
    kinematics, period_ns = run.controller.kinematics, run.session.period_ns
    plan = DemoPlan.load_plan(file, run.motion_ticks * period_ns)
    R_WT, p_WT = kinematics.forward(run.session.scene.start)
    target = Pose(p_WT + plan.displacement, R_WT)
    run.instructor.add(plan.settle_ns, target)
    count = plan.instructions if instructions is None else instructions
    deviations = np.full((count + 1, 3), np.nan)
    with contextlib.suppress(Diverged):
        run.advance(plan.settle_ns // period_ns)
        for row in deviations:
            row[:] = target.p_WT - kinematics.forward(run.session.state.q)[1]
            run.advance(run.motion_ticks)
    return deviations


@dataclass(frozen=True)
class ResidualOutcome:
    """Result of the demo of one arm."""

    residual: float  # mm, that remains at the end
    away: float  # mm, by which it was away from the scene's own arm at most, before any instruction
    settled: int | None  # instructions until it was within 2 % of the way; None: never


def measure_outcome(deviations: Array, nominal: Array) -> ResidualOutcome:
    """Return it, of the deviations (K + 1, 3) [m]."""
    distance = np.linalg.norm(deviations, axis=1)
    below = np.flatnonzero(distance < 0.02 * np.linalg.norm(nominal[0]))
    away = float(np.linalg.norm(deviations - nominal, axis=1).max())
    return ResidualOutcome(
        1e3 * float(distance[-1]), 1e3 * away, int(below[0]) if len(below) else None
    )


def measure_scene(scene_name: str, quick: bool = False) -> dict[str, Any]:
    """Make the demo over the ranges of a scene."""
    assumed = list_assumed(find_scene(scene_name))
    rng = np.random.default_rng(1)
    arms: list[Values] = [{}]
    for figure in assumed:
        arms += [figure.scale_numbers(figure.low), figure.scale_numbers(figure.high)]
    for _ in range(2 if quick else SAMPLED_ARMS):
        arm: Values = dict(assumed[0].nominal)
        for figure in assumed:
            factors, sample = figure.nominal, figure.scale_numbers(figure.draw_value(rng))
            # A ratio changes what was drawn of the motor before.
            arm |= {name: arm[name] * value / factors[name] if factors[name] else value
                    for name, value in sample.items()}  # fmt: skip
        arms.append({name: value for name, value in arm.items() if not name.endswith("ratio")})
    deviations = simulate_demos(scene_name, arms, 30 if quick else None)
    outcomes = [asdict(measure_outcome(deviation, deviations[0])) for deviation in deviations]
    ends = len(assumed)
    return {
        "nominal": outcomes[0],
        "rows": [
            {"figure": figure.label, "joints": list(figure.joints), "value": figure.value,
             "range": [figure.low, figure.high], "ends": outcomes[1 + 2 * k : 3 + 2 * k]}
            for k, figure in enumerate(assumed)
        ],
        "drawn": outcomes[1 + 2 * ends :],
    }  # fmt: skip


def run_bench(quick: bool) -> dict[str, Any]:
    """Measure all arms."""
    return {name: measure_scene(name, quick) for name in ARMS}


def write_report(figures: dict[str, Any]) -> str:
    """Return the tables."""
    return "\n\n".join(make_table(name, of_arm) for name, of_arm in figures.items())


def make_table(name: str, figures: dict[str, Any]) -> str:
    """Return the table of one arm, in Markdown."""

    def write_cell(deviation: dict[str, Any]) -> str:
        settled = "never" if deviation["settled"] is None else deviation["settled"]
        if not np.isfinite(deviation["residual"]):
            return "diverged"
        return f"{deviation['residual']:.2f} / {deviation['away']:.2f} / {settled}"

    rows = []
    for row in figures["rows"]:
        low, high = row["range"]
        figure, joints = f"`{row['figure']}`", f"{row['joints'][0]} to {row['joints'][-1]}"
        range_texts = f"{row['value']:.3g}", f"{low:.3g} to {high:.3g}"
        rows.append((figure, joints, *range_texts, *map(write_cell, row["ends"])))
    heads = "figure", "joints", "scene", "range", "at its low end", "at its high end"
    lines = [
        f"{name}, as its scene has it: {write_cell(figures['nominal'])}.",
        "",
        format_table(heads, rows),
    ]
    samples = figures["drawn"]
    sound = [sample for sample in samples if np.isfinite(sample["residual"])]
    if sound:
        residual, away = ([sample[key] for sample in sound] for key in ("residual", "away"))
        settled = [sample["settled"] for sample in sound if sample["settled"] is not None]
        lines += [
            "",
            f"{len(samples)} arms with all figures drawn: {len(samples) - len(sound)} diverged; "
            f"{min(residual):.2f} to {max(residual):.2f} mm remain (median "
            f"{np.median(residual):.2f}), at most {max(away):.2f} mm away, "
            f"{len(settled)} within 2 %"
            + (f", after {min(settled)} to {max(settled)} instructions." if settled else "."),
        ]
    return "\n".join(lines)
