"""Pairs of parts, at one joint and at two: the order that the pages promise.

A machine is a random chain of two links whose joints have many parts each. `draw_machines`
continues until each part has stood beside every part that a joint can have with it, and opposite
every part at the other joint.

All numbers are data of a machine, so that many draws share one library. A draw replaces all of
them. Some parts get the numbers that switch them off, and others 0 where 0 is allowed: the
schemes must keep their order there, too. Commands go to all inputs of all motors. Some are beyond
what a motor can follow, and the power is off on the way. Claims:

- located events: halving the step twice shows order 2 in the positions;
- events at steps: the error falls with the step, against a located motion in small steps.

The order is that of differences between runs, as in oracles/mixtures.py. Each part by itself is
compared with a closed form in test/.
"""

from __future__ import annotations

import itertools
import math
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from arm_emulator import Diverged, Plant, Scene, load_scene
from arm_emulator.base.validation.section import Section
from arm_emulator.machine.parts.bearing import Deflection
from arm_emulator.machine.parts.drive_stages.drive_stage import DriveStage
from arm_emulator.machine.parts.frictions.brake import Brake
from arm_emulator.machine.parts.part import Part
from arm_emulator.machine.plant.inputs import find_input, list_further_inputs
from arm_emulator.machine.scene.known_parts import (
    DECORATORS,
    DEFLECTIONS,
    EXTRAS,
    GEAR_STAGES,
    GEARS,
    LINK_FRICTIONS,
    MOTORS,
    ROTOR_FRICTIONS,
    read_motor,
)
from arm_emulator.machine.schemes.known import LOCATING_SCHEMES
from oracles.mixtures import (
    LARGEST,
    ORDER,
    RESOLVED,
    choose_any,
    get_section_key,
    is_suitable,
    place_of,
    write_scene,
)
from oracles.part_truths import draw_part, fit_friction_to_gear
from oracles.random_chain import list_moving_joints, write_random_chain

Rng = np.random.Generator
Kind = type[Part]
Pair = tuple[bool, frozenset[str]]  # whether at one joint, and the names of the parts

PERIOD = 0.01  # s, that each command is held
ROWS, UNPOWERED = 12, slice(5, 8)  # commands; those without power, in half of the draws
# Steps in PERIOD of the first run, and how often they are halved: one of these shows the order. The
# last ones average over corners, whose errors of order 2 scatter.
WINDOWS = ((20, 3), (80, 3), (320, 3), (40, 6), (80, 6))
SIZES = (0.5, 1.0, 4.0)  # of commands, in mixtures.LARGEST
# Three numbers for schemes that place events at steps. Runs with the first numbers of steps are
# coarse. A fine run has so many times as many, and its largest error is smaller by the last factor
# at least. An event may lie well in a step or badly, so that single errors scatter.
COARSE, FINER, FALLS = (20, 40, 80), 32, 4.0
# Where the error of a fine run has not fallen, that of so many times as many steps must have.
STILL_FINER = 16
CANDIDATES = 40  # machines, of which the one with the most new pairs is taken

# Numbers that switch a part off, by the end of their names. Other numbers are 0, where they may.
OFF = {
    "current_limit": 1e6,
    "torque_limit": 1e6,
    "end_stops.lower": -1e3,
    "end_stops.upper": 1e3,
    "lugre.coulomb": 1e-9,
    "lugre.bristle_stiffness": 1e-7,
}
SHARE_OFF, SHARE_ZERO = 0.4, 0.2  # of the parts
# These stay as drawn: the first needs a motor without decorators, others are no sizes.
NEVER_ZERO = {"inductance", "ambient", "reference", "lower", "upper"}


@dataclass(frozen=True)
class RandomJoint:
    """A joint's section of the scene, and the kinds of its parts."""

    section: dict[str, Any] = field(default_factory=dict)
    kinds: list[Kind] = field(default_factory=list)

    def put_part(self, kind: Kind, rng: Rng) -> None:
        """Add a part where the section has its place."""
        if issubclass(kind, DriveStage):
            kind = kind.find_kind(read_motor(Section(self.section["motor"], "pair")))
        place = place_of(self.section, kind)
        if place is not None:
            place[get_section_key(kind)] = {
                **draw_part(kind, rng),
                **place.get(get_section_key(kind), {}),
            }
            self.kinds.append(kind)


def draw_random_joint(rng: Rng) -> RandomJoint:
    """Return a joint with a motor, a gear, friction of both shafts, and half of all else."""
    joint = RandomJoint()
    motor = choose_any(rng, MOTORS)
    joint.section["motor"] = {"kind": motor.kind, "rotor_inertia": float(rng.uniform(5e-5, 3e-4))}
    joint.put_part(motor, rng)
    for decorator in DECORATORS:
        if rng.random() < 0.5 and is_suitable(decorator, joint.section["motor"]):
            joint.put_part(decorator, rng)
    always: tuple[tuple[Kind, ...], ...] = (GEARS, LINK_FRICTIONS, ROTOR_FRICTIONS)
    for kinds in always:
        joint.put_part(choose_any(rng, kinds), rng)
    fit_friction_to_gear(joint.section)
    gear = joint.section["gear"]
    within_gear = GEAR_STAGES if "stiffness" in gear and "backlash" not in gear else ()
    sometimes: tuple[Kind, ...] = (Brake, *within_gear, *EXTRAS)
    for kind in sometimes:
        if rng.random() < 0.5:
            joint.put_part(kind, rng)
    if rng.random() < 0.5:
        of_joint = str(rng.choice(list("xyz")))
        for deflection in DEFLECTIONS:
            if deflection.axis != of_joint:
                joint.put_part(deflection, rng)
    return joint


def choose_axis(joint: RandomJoint) -> str | None:
    """Return an axis across all directions of a joint's bearing, None if it is rigid."""
    taken = {kind.axis for kind in joint.kinds if issubclass(kind, Deflection)}
    free = next(axis for axis in "xyz" if axis not in taken)
    return " ".join("1" if axis == free else "0" for axis in "xyz") if taken else None


def list_pairs(joints: tuple[RandomJoint, RandomJoint]) -> set[Pair]:
    """Return the pairs of parts that stand beside or opposite each other."""
    names = [[kind.__name__ for kind in joint.kinds] for joint in joints]
    beside = (itertools.combinations(kinds, 2) for kinds in names)
    return {(True, frozenset(pair)) for pair in itertools.chain(*beside)} | {
        (False, frozenset(pair)) for pair in itertools.product(*names)
    }


@cache
def list_all_pairs() -> frozenset[Pair]:
    """Return the pairs that machines can have."""
    rng = np.random.default_rng(0)
    pairs = (list_pairs((draw_random_joint(rng), draw_random_joint(rng))) for _ in range(1500))
    return frozenset(set().union(*pairs))


def draw_machines() -> Iterator[tuple[RandomJoint, RandomJoint]]:
    """Yield the joints of machines until they have had all pairs."""
    rng, left = np.random.default_rng(1), set(list_all_pairs())
    while left:
        some = [(draw_random_joint(rng), draw_random_joint(rng)) for _ in range(CANDIDATES)]
        best = max(some, key=lambda joints: len(left & list_pairs(joints)))
        left -= list_pairs(best)
        yield best


def write_machine(folder: Path, joints: tuple[RandomJoint, RandomJoint], seed: int) -> Path:
    """Write the scene of a machine, all of whose numbers may differ, and return its path.

    The axis of a joint is random, unless its bearing gives way: it must be across all directions.
    """
    urdf = write_random_chain(np.random.default_rng([seed, 51]), 2)
    robot, sections = ET.fromstring(urdf), {}
    for name, joint in zip(list_moving_joints(urdf), joints, strict=True):
        sections[name] = joint.section
        element, xyz = robot.find(f"joint[@name='{name}']/axis"), choose_axis(joint)
        assert element is not None
        if xyz is not None:
            element.set("xyz", xyz)
    urdf = ET.tostring(robot, encoding="unicode")
    return write_scene(folder, urdf, sections, varied=["joints.*"], energy_flow=False)


@dataclass(frozen=True)
class Draw:
    """Numbers and commands of one run of a machine."""

    numbers: dict[str, float]
    off: tuple[str, ...]  # names of the parts that are switched off, by joint
    rows: np.ndarray  # (ROWS, N)
    further: dict[str, np.ndarray]  # (ROWS, N) of each further input
    powered: np.ndarray  # (ROWS,)


def draw_machine(scene: Scene, joints: tuple[RandomJoint, RandomJoint], seed: int) -> Draw:
    """Draw numbers and commands for a machine."""
    rng = np.random.default_rng([seed, 52])
    varied = {number.name: number for number in scene.varied}
    numbers: dict[str, float] = {}
    off: list[str] = []
    for name, joint in zip(scene.joint_names, joints, strict=True):
        for kind in joint.kinds:
            own_numbers, is_off = draw_part(kind, rng), rng.random() < SHARE_OFF
            zero = rng.random() < SHARE_ZERO
            if is_off:
                off.append(f"{name}.{kind.__name__}")
            for key in kind.list_numbers():
                full = f"joints.{name}.{kind.section}.{key}"
                if full not in varied:
                    continue
                number = varied[full]
                value = own_numbers.get(key, number.value * float(rng.uniform(0.8, 1.25)))
                ends = number.number.ends
                end = next((end for end in OFF if full.endswith(end)), None)
                may_be_zero = ends[0] <= 0.0 <= ends[1] and key not in NEVER_ZERO
                if is_off and end is not None:
                    value = OFF[end]
                elif may_be_zero and (is_off or (zero and rng.random() < 0.5)):
                    value = 0.0
                numbers[full] = float(np.clip(value, *ends))
    size = rng.choice(SIZES, 2) * [LARGEST.get(joint.unit, 0.0) for joint in scene.joints]
    rows = rng.uniform(-1.0, 1.0, (ROWS, 2)) * size
    further = {}
    for name in list_further_inputs(scene):
        at = [find_input(joint, name) for joint in scene.joints]
        largest = np.array([LARGEST[output.unit] if output else 0.0 for output in at])
        further[name] = rng.uniform(-1.0, 1.0, (ROWS, 2)) * largest * rng.choice(SIZES)
    powered = np.ones(ROWS, bool)
    if rng.random() < 0.5:
        powered[UNPOWERED] = False
    return Draw(numbers, tuple(off), rows, further, powered)


@dataclass(frozen=True)
class PairVerdict:
    """Result of one draw of one machine."""

    machine: int
    seed: int
    scheme: str
    located: bool
    parts: list[str]
    off: tuple[str, ...]
    differences: tuple[float, ...]  # rad or m; of runs that follow each other
    steps: int  # in PERIOD, of the first of them
    order: float
    in_order: bool


def simulate_sample(file: Path, sample: Draw, steps: int, scheme: str, events: str) -> np.ndarray:
    """Return the positions after each command, deflections of bearings among them."""
    integrator = {"dt": PERIOD / steps, "scheme": scheme, "events": events}
    plant = Plant(
        load_scene(file, {f"integrator.{key}": value for key, value in integrator.items()})
    )
    for name, value in sample.numbers.items():
        plant.set_parameter(name, value)
    q = []
    for k, row in enumerate(sample.rows):
        plant.powered = bool(sample.powered[k])
        plant.exchange(row, came=False, **{name: of[k] for name, of in sample.further.items()})
        q.append(plant.machine_motion[0])
    return np.array(q)


def judge_pair(
    file: Path, joints: tuple[RandomJoint, RandomJoint], machine: int, seed: int, scheme: str
) -> PairVerdict:
    """Judge a draw with a scheme, whose events are located if it can."""
    located = scheme in LOCATING_SCHEMES
    sample = draw_machine(load_scene(file), joints, 1000 * machine + seed)
    parts = [kind.__name__ for joint in joints for kind in joint.kinds]

    @cache
    def run_steps(steps: int, scheme: str = scheme, events: str = "step") -> np.ndarray | None:
        try:
            return simulate_sample(file, sample, steps, scheme, events)
        except Diverged:
            return None

    def make_verdict(
        differences: tuple[float, ...], steps: int, halvings: int, order_needed: float
    ) -> PairVerdict:
        first, last = differences[0], differences[-1]
        order = math.log2(first / last) / halvings if 0.0 < last <= first < math.inf else 0.0
        in_order = last < RESOLVED or order >= order_needed
        return PairVerdict(machine, seed, scheme, located, parts, sample.off, differences, steps,
                           order, in_order)  # fmt: skip

    if not located:
        finest = COARSE[-1] * FINER
        truth = run_steps(2 * finest, LOCATING_SCHEMES[0], "located")
        coarse = [_measure_distance(run_steps(steps), truth) for steps in COARSE]
        largest = max((error for error in coarse if error < math.inf), default=math.inf)
        errors = largest, _measure_distance(run_steps(finest), truth)
        judged = make_verdict(errors, COARSE[0], round(math.log2(FINER)), math.log(FALLS, FINER))
        if judged.in_order:
            return judged
        # Coarse runs that diverge, or whose events lie alike, hide the order of small steps.
        truth = run_steps(2 * STILL_FINER * finest, LOCATING_SCHEMES[0], "located")
        errors = (
            _measure_distance(run_steps(finest), truth),
            _measure_distance(run_steps(STILL_FINER * finest), truth),
        )
        return make_verdict(
            errors, finest, round(math.log2(STILL_FINER)), math.log(FALLS, STILL_FINER)
        )
    for steps, halvings in WINDOWS:
        runs = [run_steps(steps << k, scheme, "located") for k in range(halvings + 2)]
        judged = make_verdict(tuple(map(_measure_distance, runs, runs[1:])), steps, halvings, ORDER)
        if judged.in_order:
            break
    return judged


def _measure_distance(first: np.ndarray | None, second: np.ndarray | None) -> float:
    return math.inf if first is None or second is None else float(np.abs(first - second).max())
