"""Random mixtures of all parts of a drive: order, energy and lanes.

Each machine is a random chain of two links whose joints have parts drawn from all parts
(machine/scene/known_parts.py). Commands that jump move it; some machines are under a wrench, some
are braked on the way. Claims, with rosenbrock and events located:

- halving the step twice shows order 2 in the positions, or `Diverged` is raised;
- the residual of energy, given - stored - dissipated, falls with that order;
- four machines side by side go as each of them alone, to the last bit (every third mixture).

There is no truth that knows all parts at once: the order is that of the differences between runs
with steps of 1, 1/2 and 1/4. An order is one of small steps: where the fastest winding or the
shortest wave is not yet resolved by steps of 0.5 to 0.125 ms, these are halved further, down to
16 us; the three steps that are judged are printed. Each part by itself is compared with a closed
form in test/.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import yaml

from arm_emulator import Diverged, ExternalWrench, Plant, Refusal, Scene, load_scene
from arm_emulator.base.validation.section import Section
from arm_emulator.machine.parts.bearing import SECTION, Deflection
from arm_emulator.machine.parts.drive_stages.drive_stage import DriveStage
from arm_emulator.machine.parts.frictions.brake import Brake
from arm_emulator.machine.parts.gears.gear import Gear
from arm_emulator.machine.parts.motors.motor import Motor
from arm_emulator.machine.parts.part import Part
from arm_emulator.machine.scene.known_parts import (
    DECORATORS,
    EXTRAS,
    GEARS,
    LINK_FRICTIONS,
    MOTORS,
    ROTOR_FRICTIONS,
    read_motor,
)
from arm_emulator_fleet import Fleet
from oracles.part_truths import draw_part, draw_scaled, fit_friction_to_gear
from oracles.random_chain import list_moving_joints, write_random_chain

PERIOD, ROWS = 0.01, 20  # s, that each command is held, and how many of them
STEPS = (20, 40, 80)  # in a period
FINEST = 640  # steps in a period, at which a mixture must show its order at the latest
BRAKED = slice(8, 14)  # rows in which the power is off
ORDER = 1.5  # at least; 2 is what is claimed, and events may lie so that it shows a bit less
RESOLVED = 1e-9  # rad or m: differences below are of rounding and of event times
BALANCED = 1e-7  # of the energy exchanged
LARGEST = {"V": 12.0, "N m": 0.3, "A": 6.0}  # commands
LANES = 4

Rng = np.random.Generator
Numbers = dict[str, Any]
Kind = TypeVar("Kind")


def _draw_rotor(rng: Rng) -> Numbers:
    inertia = draw_scaled(rng, 5e-5, 3e-4)
    law = draw_part(choose_any(rng, ROTOR_FRICTIONS), rng)
    return {"rotor_inertia": inertia, **({"friction": law} if rng.random() < 0.5 else {})}


def choose_any(rng: Rng, kinds: Sequence[Kind]) -> Kind:
    """Return one of some kinds of parts, each as often as the others."""
    return kinds[int(rng.integers(len(kinds)))]


def draw_motor(rng: Rng, kind: type[Motor]) -> Numbers:
    """Return the scene's section of a motor without its rotor, half of them in a loop."""
    motor = {"kind": kind.kind, **draw_part(kind, rng)}
    for decorator in DECORATORS:
        if (
            decorator.inputs
            and is_suitable(decorator, motor | {"rotor_inertia": 1e-4})
            and rng.random() < 0.5
        ):
            motor[get_section_key(decorator)] = draw_part(decorator, rng)
    return motor


def draw_joint(rng: Rng) -> Numbers:
    """Return the scene's section of a joint with random parts."""
    joint: Numbers = {}
    if rng.random() < 0.6:
        joint["friction"] = draw_part(choose_any(rng, LINK_FRICTIONS), rng)
    if rng.random() < 0.9:
        joint["motor"] = {**draw_motor(rng, choose_any(rng, MOTORS)), **_draw_rotor(rng)}
        joint["gear"] = draw_part(choose_any(rng, GEARS), rng)
        fit_friction_to_gear(joint)
    for extra in EXTRAS:
        if rng.random() < 0.3 and (place := place_of(joint, extra)) is not None:
            place[get_section_key(extra)] = draw_part(extra, rng)
    return joint


def get_section_key(part: type[Part]) -> str:
    """Return the key of a part's section in the one above."""
    return part.section.rpartition(".")[2]


def place_of(joint: Numbers, part: type[Part]) -> Numbers | None:
    """Return the section of a joint in which a part stands, None if it is not there."""
    above = part.section.rpartition(".")[0]
    if issubclass(part, Deflection):
        joint.setdefault(SECTION, {})  # it needs nothing but its joint
    return joint.get(above) if above else joint


def add_surroundings(rng: Rng, scene: Numbers) -> None:
    """Add what acts on other parts: decorators of motors, brakes, a wrench."""
    for joint in scene["joints"].values():
        motor = joint.get("motor")
        if motor is None:
            continue
        for kind in DECORATORS[::-1]:
            if is_suitable(kind, motor) and rng.random() < 0.3:
                motor[get_section_key(kind)] = draw_part(kind, rng)
        if rng.random() < 0.2:
            joint[Brake.section] = draw_part(Brake, rng)
    scene["external_wrench"] = bool(rng.random() < 0.3)


def is_suitable(kind: type[DriveStage], motor: Numbers) -> bool:
    """Return whether a decorator goes around a motor."""
    joint = Section({"motor": motor}, "mixture")
    section = draw_part(kind, np.random.default_rng(0))
    try:
        bare = read_motor(Section(motor, "mixture"))
        kind.read_section(Section(section, "mixture")).check_motor(bare, joint)
    except Refusal:
        return False
    return True


def write_mixture(folder: Path, seed: int) -> Path:
    """Write the scene of a mixture and return its path."""
    rng = np.random.default_rng([seed, 4242])
    urdf = write_random_chain(rng, 2)
    joints = {name: draw_joint(rng) for name in list_moving_joints(urdf)}
    scene: Numbers = {"joints": joints}
    add_surroundings(np.random.default_rng([seed, 4243]), scene)
    return write_scene(folder, urdf, joints, external_wrench=scene["external_wrench"])


def draw_alone(part: type[Part], seed: int) -> Numbers:
    """Return the scene's section of a joint without friction and limits but for one part."""
    rng = np.random.default_rng([seed, 4244, *part.__name__.encode()])
    rotor = {"rotor_inertia": 1e-4}
    motor: Numbers = {
        "resistance": 1.0, "inductance": 2e-3, "torque_constant": 0.05, "back_emf_constant": 0.05,
        **rotor,
    }  # fmt: skip
    if issubclass(part, DriveStage):
        for kind in MOTORS:
            if part.around_kind == kind.kind:
                motor = {"kind": kind.kind, **rotor, **draw_motor(rng, kind)}
    joint: Numbers = {"motor": motor, "gear": {"ratio": 0.02, "stiffness": 3e3, "damping": 2.0}}
    if issubclass(part, Motor):
        joint["motor"] = {**rotor, **draw_motor(rng, part)}
    elif issubclass(part, Gear):
        joint["gear"] = draw_part(part, rng)
    else:
        section, place = draw_part(part, rng), place_of(joint, part)
        assert place is not None, "it has a motor and a gear"
        place[get_section_key(part)] = section
    return joint


def write_scene(folder: Path, urdf: str, joints: Numbers, **more: Any) -> Path:
    """Write a scene whose events are located, and return its path."""
    (folder / "mixture.urdf").write_text(urdf)
    scene = {
        "name": "mixture",
        "urdf": "mixture.urdf",
        "tool": "base",
        "gravity": [0.0, 0.0, -9.81],
        "supply_voltage": 24.0,
        "joints": joints,
        "integrator": {"dt": PERIOD / STEPS[0], "events": "located"},
        "servo_period": PERIOD,
        "energy_flow": True,
        **more,
    }
    file = folder / "mixture.yaml"
    file.write_text(yaml.safe_dump(scene, sort_keys=False))
    return file


@dataclass(frozen=True)
class MixtureVerdict:
    """Result of one mixture."""

    seed: int
    parts: list[str]
    order: float  # of the positions
    differences: tuple[float, float]  # rad or m, between the runs
    left: tuple[float, ...]  # of the energy exchanged, by step
    steps: tuple[int, ...]  # in a period, of the runs that are judged
    lanes: float  # rad or m, by which lanes differ from machines alone
    note: str = ""

    @property
    def is_in_order(self) -> bool:
        """Whether the positions converge as claimed."""
        return self.note != "" or self.order >= ORDER or self.differences[1] < RESOLVED

    @property
    def is_balanced(self) -> bool:
        """Whether the energy balance closes as claimed."""
        falls = self.left[-1] < self.left[0] / 2 ** (2 * ORDER) if self.left else False
        return self.note != "" or falls or self.left[-1] < BALANCED

    @property
    def has_equal_lanes(self) -> bool:
        """Whether lanes go as machines alone."""
        return self.note != "" or self.lanes == 0.0

    @property
    def claims(self) -> dict[str, bool]:
        """Return all claims by name."""
        return {
            "order": self.is_in_order,
            "balance": self.is_balanced,
            "lanes": self.has_equal_lanes,
        }


def draw_commands(scene: Scene, seed: int) -> np.ndarray:
    """Return commands (ROWS, N) that jump, in the unit of each motor."""
    rng = np.random.default_rng([seed, 77])
    size = np.array([LARGEST[joint.unit] if joint.motor else 0.0 for joint in scene.joints])
    rows: np.ndarray = rng.uniform(-1.0, 1.0, (ROWS, len(size))) * size
    rows[BRAKED] = 0.0  # which is what motors without power get
    return rows


def push_link(plant: Plant, seed: int) -> None:
    """Let a wrench act on the last link, if the mixture knows wrenches."""
    if plant.scene.external_wrench:
        force, moment = np.random.default_rng([seed, 78]).normal(0.0, 5.0, (2, 3)).tolist()
        plant.set_external_wrench(plant.scene.chain.joints[-1].link, ExternalWrench(force, moment))


def run_rows(scene: Scene, seed: int, rows: np.ndarray, steps: int) -> tuple[np.ndarray, float]:
    """Return positions after each row, and the residual of the energy as a share of the exchanged.

    Positions are those of all joints of the machine: deflections of bearings are among them.
    """
    plant = Plant(scene)
    push_link(plant, seed)
    began, supplied, exchanged, q = plant.energy, 0.0, 1e-3, []
    for k, row in enumerate(rows):
        plant.powered = not BRAKED.start <= k < BRAKED.stop  # which brakes follow
        flow = plant.advance_metered(row, steps)
        supplied += float((flow.supplied - flow.dissipated).sum())
        exchanged += float(np.abs(flow.supplied).sum() + np.abs(flow.dissipated).sum())
        q.append(plant.machine_motion[0])
    return np.array(q), abs(plant.energy - began - supplied) / exchanged


def judge_mixture(seed: int) -> MixtureVerdict:
    """Draw a mixture and hold the claims against it."""
    with tempfile.TemporaryDirectory() as folder:
        file = write_mixture(Path(folder), seed)

        def load_mixture(steps: int, events: str = "located") -> Scene:
            return load_scene(file, {"integrator.dt": PERIOD / steps, "integrator.events": events})

        first = load_mixture(STEPS[0])
        parts = sorted({type(part).__name__ for joint in first.joints for part in joint.parts})
        if first.external_wrench:
            parts.append("ExternalWrench")
        rows = draw_commands(first, seed)
        try:
            verdict, _ = find_converged(
                seed, parts, lambda steps: run_rows(load_mixture(steps), seed, rows, steps)
            )
            if seed % 3 == 0:
                verdict = replace(
                    verdict, lanes=compare_lanes(load_mixture(STEPS[1], "step"), seed, rows)
                )
        except Diverged as fault:
            return MixtureVerdict(
                seed, parts, 0.0, (0.0, 0.0), (), (), 0.0, f"Diverged: {fault.joint}"
            )
    return verdict


def find_converged(
    seed: int, parts: list[str], run_in: Callable[[int], tuple[np.ndarray, float]]
) -> tuple[MixtureVerdict, np.ndarray]:
    """Run in smaller and smaller steps until order shows; return that and the finest positions.

    Args:
        seed: of the mixture.
        parts: their names.
        run_in: positions after each row, and the residual of the energy, by steps in a period.
    """
    steps, runs = STEPS[-1], [run_in(steps) for steps in STEPS]
    verdict = _judge_runs(seed, parts, runs, STEPS)
    while not (verdict.is_in_order and verdict.is_balanced) and 2 * steps <= FINEST:
        steps *= 2
        runs = [*runs[1:], run_in(steps)]
        verdict = _judge_runs(seed, parts, runs, (steps // 4, steps // 2, steps))
    return verdict, runs[-1][0]


def _judge_runs(
    seed: int, parts: list[str], runs: list[tuple[np.ndarray, float]], steps: tuple[int, ...]
) -> MixtureVerdict:
    d = [float(np.abs(a - b).max()) for (a, _), (b, _) in pairwise(runs)]
    order = float(np.log2(d[0] / d[1])) if d[1] > 0.0 < d[0] else 2.0
    return MixtureVerdict(
        seed, parts, order, (d[0], d[1]), tuple(left for _, left in runs), steps, 0.0
    )


def compare_lanes(scene: Scene, seed: int, rows: np.ndarray) -> float:
    """Return by how much machines side by side differ from the same machines alone."""
    fleet, worst = Fleet(scene, LANES), 0.0
    factors = 1.0 - 0.1 * np.arange(LANES)
    for lane in range(LANES):
        push_link(fleet[lane], seed)
    q = fleet.run(rows[:, None, :] * factors[None, :, None], STEPS[1])
    for lane, factor in enumerate(factors):
        alone = Plant(scene)
        push_link(alone, seed)
        moved = alone.run(rows * factor, STEPS[1])
        worst = max(worst, float(np.abs(q[:, lane] - moved).max()))
    return worst
