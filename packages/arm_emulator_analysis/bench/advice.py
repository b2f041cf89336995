"""Advice of `advise`, compared with brute force and with unseen motions, by bench/claims.py.

Each scene is a random chain of one or two links: with dry friction, with play, with limits, with
synchronous motors, with motors that are commanded torques or currents, in turns. For each error
that is asked for, claims of the setting that is advised:

- on its own motions and on five others its true error is at most the one published;
- it costs at most 1.3 times as much as the cheapest setting that keeps the error on all of these
  motions. The search for this setting tries all schemes, events and steps.

The true motions are found again, five times as well;
packages/arm_emulator_analysis/test/test_advice.py compares them with independent solutions.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from arm_emulator.machine.parts.gears.backlash_gear import BacklashGear
from arm_emulator.machine.parts.gears.elastic_gear import ElasticGear
from arm_emulator.machine.parts.gears.gear import RigidGear
from arm_emulator.machine.parts.joint_effects.end_stops import EndStops
from arm_emulator.machine.parts.motors.current_motor import CurrentMotor
from arm_emulator.machine.parts.motors.dc_motor import DcMotor
from arm_emulator.machine.parts.motors.pmsm import Pmsm
from arm_emulator.machine.parts.motors.torque_motor import TorqueMotor
from arm_emulator.machine.scene.known_parts import LINK_FRICTIONS, ROTOR_FRICTIONS
from arm_emulator.machine.scene.scene import Scene, load_scene
from arm_emulator_analysis.advice import Advice, Judge, find_cheapest_settings, step_counts
from arm_emulator_analysis.judged_motions import (
    KINDS,
    SECONDS,
    ExcitationMotions,
    JudgedMotion,
    list_motions,
)
from arm_emulator_analysis.true_motion import IntegrationMethod
from oracles import mixtures
from oracles.part_truths import draw_part, draw_scaled, fit_friction_to_gear
from oracles.random_chain import list_moving_joints, write_random_chain

CLASSES = ("friction", "play", "limits", "pmsm", "torque")
ERRORS = (1e-3, 1e-4, 1e-5, 1e-6)  # rad or m
OTHERS = 5
DEARER = 1.3  # than the cheapest, at most
MANY = 64  # times the steps that are advised, of methods whose steps may cost less

Rng = np.random.Generator
Numbers = dict[str, Any]


def draw_joint_section(rng: Rng, kind: str) -> Numbers:
    """Return the scene's section of a joint that has what its class is about."""
    inertia = {"rotor_inertia": draw_scaled(rng, 5e-5, 3e-4)}
    joint: Numbers = {"friction": {"viscous": draw_scaled(rng, 0.05, 0.5)}}
    motor = {**mixtures.draw_motor(rng, DcMotor), **inertia}
    gear = draw_part(ElasticGear if rng.random() < 0.5 else RigidGear, rng)
    dry = draw_part(mixtures.choose_any(rng, LINK_FRICTIONS), rng)
    if kind == "friction":
        joint["friction"] = dry
        if rng.random() < 0.5:
            motor["friction"] = draw_part(mixtures.choose_any(rng, ROTOR_FRICTIONS), rng)
    elif kind == "play":
        gear = draw_part(BacklashGear, rng)
        if rng.random() < 0.5:
            joint["friction"] = dry
    elif kind == "limits":
        motor["current_limit"] = draw_scaled(rng, 2.0, 8.0)
        joint["end_stops"] = draw_part(EndStops, rng)
    elif kind == "pmsm":
        motor = {**mixtures.draw_motor(rng, Pmsm), **inertia}
    elif kind == "torque":
        which = mixtures.choose_any(rng, (TorqueMotor, CurrentMotor))
        motor = {**mixtures.draw_motor(rng, which), **inertia}
        if rng.random() < 0.5:
            joint["friction"] = dry
    joint |= {"motor": motor, "gear": gear}
    fit_friction_to_gear(joint)
    return joint


def draw_scene(folder: Path, seed: int) -> tuple[str, Scene]:
    """Write a scene of one of the classes; return the class and the scene."""
    rng, kind = np.random.default_rng([seed, 31]), CLASSES[seed % len(CLASSES)]
    urdf = write_random_chain(rng, int(rng.integers(1, 3)))
    (folder / "advised.urdf").write_text(urdf)
    file = folder / "advised.yaml"
    scene = {
        "name": "advised",
        "urdf": "advised.urdf",
        "tool": "base",
        "gravity": [0.0, 0.0, -9.81],
        "supply_voltage": 24.0,
        "joints": {name: draw_joint_section(rng, kind) for name in list_moving_joints(urdf)},
        "integrator": {"dt": 1e-3},
        "servo_period": 1e-3,
    }
    file.write_text(yaml.safe_dump(scene))
    return kind, load_scene(file)


def draw_unseen_motions(scene: Scene, seed: int, seconds: float = SECONDS) -> list[JudgedMotion]:
    """Return motions that `advise` has not seen."""
    rng, excitation = np.random.default_rng([seed, 32]), ExcitationMotions(scene, seconds)
    kinds = [str(kind) for kind in rng.choice(list(KINDS), OTHERS)]
    return [excitation.draw_motion(kind, rng) for kind in kinds]


@dataclass(frozen=True)
class AdviceVerdict:
    """Result of one scene for one error."""

    seed: int
    kind: str
    wanted: float  # rad or m
    setting: str = ""
    dt: float = 0.0  # s
    stated: float = 0.0  # rad or m, on its own motions
    own: float = 0.0  # true
    stated_of_others: float = 0.0
    others: float = 0.0  # true
    cost: float = 0.0  # of the cheapest of all settings; at least what was tried of them
    cheapest: str = ""
    tried: int = 0
    none: str = ""  # why no setting was advised

    @property
    def is_true(self) -> bool:
        """Whether errors are at most those stated."""
        return bool(self.none) or (
            self.own <= self.stated <= self.wanted and self.others <= self.stated_of_others
        )

    @property
    def is_cheap(self) -> bool:
        """Whether hardly anything is cheaper."""
        return self.cost <= DEARER

    @property
    def claims(self) -> dict[str, bool]:
        """Return all claims by name."""
        return (
            {}
            if self.none
            else {
                "errors are at most those stated": self.is_true,
                f"at most {DEARER} times as dear as the cheapest": self.is_cheap,
            }
        )


def judge_scene(
    seed: int, seconds: float = SECONDS, errors: Sequence[float] = ERRORS
) -> list[AdviceVerdict]:
    """Draw a scene and hold the claims against it, for every error."""
    with tempfile.TemporaryDirectory() as folder:
        kind, scene = draw_scene(Path(folder), seed)
        own = Judge(scene, list_motions(scene, seconds))
        others = Judge(scene, draw_unseen_motions(scene, seed, seconds))
        advices = {
            error: find_cheapest_settings(own, error) for error in sorted(errors, reverse=True)
        }
        # All that was stated is held against truths that are known five times as well.
        fine = 0.2 * min(
            (limit for limit, advice in advices.items() if not advice.why_none), default=1.0
        )
        why = own.find_truths(fine) or others.find_truths(fine)
        return [
            AdviceVerdict(seed, kind, limit, none=advice.why_none or why)
            if advice.why_none or why
            else _judge_advice(seed, kind, limit, advice, own, others)
            for limit, advice in advices.items()
        ]


def _judge_advice(
    seed: int, kind: str, error: float, advice: Advice, own: Judge, others: Judge
) -> AdviceVerdict:
    best = advice.settings[0]
    steps = round(own.scene.servo_period / best.dt)
    tried, cheaper = 0, list[tuple[IntegrationMethod, int]]()
    for method in own.methods:
        for fewer in step_counts(1, steps * MANY):
            if own.runs.estimate_min_cost(method, fewer) > best.cost:
                break  # it is not cheaper
            tried += 1
            if (
                own.compute_max_error(method, fewer, error) <= error
                and others.compute_max_error(method, fewer, best.others) <= best.others
            ):
                cheaper.append((method, fewer))
                break
    costs = own.measure_costs([(best.method, steps), *cheaper])
    k = int(np.argmin(costs))
    method, fewer = [(best.method, steps), *cheaper][k]
    return AdviceVerdict(
        seed,
        kind,
        error,
        str(best.method),
        best.dt,
        best.error,
        own.compute_max_error(best.method, steps),
        best.others,
        others.compute_max_error(best.method, steps),
        costs[0] / costs[k],
        f"{method}, {fewer} steps",
        tried,
    )
