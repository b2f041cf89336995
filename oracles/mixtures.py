"""Random mixtures of all parts of a drive: order, energy and lanes.

Each machine is a random chain of two links whose joints have parts drawn from all parts
(machine/parts/known.py), moved by commands that jump, some under a wrench, some braked on the
way. Claims, with rosenbrock and events located:

- halving the step twice shows order 2 in the positions, or `Diverged` is raised;
- what is left of energy given - stored - dissipated falls with that order;
- four machines side by side go as each of them alone (every third mixture).

There is no truth that knows all parts at once: the order is that of the differences between runs
with steps of 1, 1/2 and 1/4. An order is one of small steps: where the fastest winding or the
shortest wave is not yet resolved by steps of 0.5 to 0.125 ms, these are halved further, down to
16 us; the three steps that are judged are printed. Each part by itself is compared with a closed
form in test/.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from arm_emulator.base.number import REQUIRED
from arm_emulator.base.refusal import Refusal
from arm_emulator.base.section import Section
from arm_emulator.machine.diverged import Diverged
from arm_emulator.machine.external_wrench import ExternalWrench
from arm_emulator.machine.fleet import Fleet
from arm_emulator.machine.parts.decorator import Decorator
from arm_emulator.machine.parts.gear import Gear
from arm_emulator.machine.parts.known import (
    DECORATORS,
    EXTRAS,
    GEARS,
    LOOPS,
    MOTORS,
    PARTS,
    read_motor,
)
from arm_emulator.machine.parts.motor import Motor, Rating
from arm_emulator.machine.parts.part import Part
from arm_emulator.machine.plant import Plant
from arm_emulator.machine.scene import Scene, load_scene
from oracles.random_chain import moving_joints, random_chain_urdf

PERIOD, ROWS = 0.01, 20  # s, that each command is held, and how many of them
STEPS = (20, 40, 80)  # in a period
FINEST = 640  # steps in a period, at which a mixture must show its order at the latest
BRAKED = slice(8, 14)  # rows in which the power is off
ORDER = 1.5  # at least; 2 is what is claimed, and events may lie so that it shows a bit less
RESOLVED = 1e-9  # rad or m: differences below are of rounding and of event times
BALANCED = 1e-7  # of the energy exchanged
LANES = 4
AS_ALONE = 1e-7  # rad or m, of lanes that go through the same events

Rng = np.random.Generator
Numbers = dict[str, Any]


def scaled(rng: Rng, low: float, high: float) -> float:
    """Draw a number of any scale between two: its logarithm is uniform."""
    return float(10 ** rng.uniform(np.log10(low), np.log10(high)))


def friction(rng: Rng, dry: float, times: float, viscous: float, speed: float) -> Numbers:
    """Return friction of one of its laws; `speed` is that of Stribeck's fall."""
    friction = {"coulomb": dry, "breakaway": times * dry, "viscous": viscous}
    if rng.random() < 0.4:
        friction["stribeck"] = speed
    if rng.random() < 0.3:
        friction["load"] = float(rng.uniform(0.05, 0.3))
    return friction


def _rotor(rng: Rng) -> Numbers:
    law = friction(rng, scaled(rng, 0.003, 0.03), 1.3, 1e-5, scaled(rng, 2.0, 20.0))
    return {
        "rotor_inertia": scaled(rng, 5e-5, 3e-4),
        **({"friction": law} if rng.random() < 0.5 else {}),
    }


def _dc(rng: Rng) -> Numbers:
    inductive = rng.random() < 0.5
    return {
        "resistance": scaled(rng, 0.5, 2.0),
        "torque_constant": 0.05,
        "back_emf_constant": 0.05,
        **({"inductance": scaled(rng, 1e-3, 5e-3)} if inductive else {}),
        **({"current_limit": scaled(rng, 3.0, 10.0)} if rng.random() < 0.5 else {}),
        **({"current_loop": _current_loop(rng)} if inductive and rng.random() < 0.5 else {}),
    }


def _current_loop(rng: Rng) -> Numbers:
    if rng.random() < 0.5:
        return {"bandwidth": scaled(rng, 100.0, 1000.0)}
    share = float(rng.uniform(0.0, 1.0))
    return {
        "proportional_gain": scaled(rng, 1.0, 10.0), "integral_gain": scaled(rng, 100.0, 5e3),
        "emf_feedforward": share,
    }  # fmt: skip


def _pmsm(rng: Rng) -> Numbers:
    return {
        "resistance": scaled(rng, 0.3, 1.0), "inductance_d": scaled(rng, 1e-3, 3e-3),
        "inductance_q": scaled(rng, 1e-3, 3e-3), "flux": scaled(rng, 0.005, 0.02), "pole_pairs": 4,
        **({"current_loop": _current_loop(rng)} if rng.random() < 0.5 else {}),
    }  # fmt: skip


def _cogging(rng: Rng) -> Numbers:
    return {"waves": [[4.0, scaled(rng, 1e-3, 1e-2), float(rng.uniform(0.0, 6.0))]]}


def _torque(rng: Rng) -> Numbers:
    return {"torque_limit": 0.5, **({"bandwidth": 200.0} if rng.random() < 0.5 else {})}


def _current(rng: Rng) -> Numbers:
    limit = {"current_limit": 10.0}
    return {
        "torque_constant": 0.05,
        **limit,
        **({"bandwidth": 200.0} if rng.random() < 0.5 else {}),
    }


def _gear(rng: Rng) -> Numbers:
    return {"ratio": scaled(rng, 0.01, 0.04) * float(rng.choice([-1.0, 1.0]))}


def _elastic(rng: Rng) -> Numbers:
    return _gear(rng) | {
        "stiffness": scaled(rng, 1e3, 1e4),
        "damping": scaled(rng, 0.5, 10.0),
    }


def _progressive(rng: Rng) -> Numbers:
    gear = _elastic(rng)
    return gear | {"cubic_stiffness": gear["stiffness"] * scaled(rng, 1e2, 1e4)}


def _backlash(rng: Rng) -> Numbers:
    return _elastic(rng) | {"backlash": scaled(rng, 1e-3, 2e-2)}


def _kinematic_error(rng: Rng) -> Numbers:
    gear = _elastic(rng)
    of_motor = [2.0, 0.1 * gear["ratio"], float(rng.uniform(0.0, 6.0))]
    return gear | {
        "kinematic_error": {"motor": [of_motor], "link": [[3.0, scaled(rng, 1e-4, 1e-2)]]}
    }


def _lugre(rng: Rng) -> Numbers:
    dry = scaled(rng, 0.2, 2.0)
    return {
        "coulomb": dry, "breakaway": dry * float(rng.uniform(1.0, 1.5)),
        "bristle_stiffness": dry / scaled(rng, 2e-3, 2e-2),
        "bristle_damping": scaled(rng, 0.3, 3.0),
    }  # fmt: skip


def _rotor_lugre(rng: Rng) -> Numbers:
    dry = scaled(rng, 0.003, 0.03)
    return {
        "coulomb": dry, "breakaway": dry * float(rng.uniform(1.0, 1.5)), "stribeck": 5.0,
        "bristle_stiffness": dry / scaled(rng, 0.2, 1.0),
        "bristle_damping": scaled(rng, 3e-4, 3e-3),
    }  # fmt: skip


def _stops(rng: Rng) -> Numbers:
    way = scaled(rng, 0.02, 0.2)
    return {"lower": -way, "upper": way, "stiffness": scaled(rng, 1e3, 2e4), "damping": 10.0}


def _torque_table(rng: Rng) -> Numbers:
    angles = np.cumsum(rng.uniform(0.05, 0.4, int(rng.integers(4, 12)))) - 1.5
    torques = rng.uniform(-5.0, 5.0, len(angles))
    periodic = bool(rng.random() < 0.5)
    if periodic:
        torques[-1] = torques[0]
    return {"angles": angles.tolist(), "torques": torques.tolist(), "periodic": periodic}


def _law(size: float, viscous: float, **more: float) -> Callable[[Rng], Numbers]:
    """Return what draws friction of one law; dry friction about a size [N m]."""

    def draw(rng: Rng) -> Numbers:
        dry = size * scaled(rng, 0.3, 3.0)
        return {"coulomb": dry, "breakaway": 1.3 * dry, "viscous": viscous, **more}

    return draw


def _ripple(rng: Rng) -> Numbers:
    return {"waves": [[6.0, float(rng.uniform(0.01, 0.1)), 1.0]]}


def _brake(rng: Rng) -> Numbers:
    # Whole numbers of the coarsest step, so that all steps brake at the same instant.
    close, release = (PERIOD / STEPS[0] * int(n) for n in rng.integers(0, 30, 2))
    return {"torque": scaled(rng, 0.02, 0.5), "close_delay": close, "release_delay": release}


def sized(kind: type[Motor]) -> Callable[[Rng], Numbers]:
    """Return what draws a motor as `new` sizes it, but for its rotor."""

    def draw(rng: Rng) -> Numbers:
        rating = Rating(
            torque=scaled(rng, 0.3, 1.0), rotor_inertia=1e-4, torque_constant=0.05,
            back_emf_constant=0.05, resistance=scaled(rng, 0.5, 2.0), inductance=2e-3,
            bandwidth=200.0,
        )  # fmt: skip
        motor = kind.sized(rating)
        values = {key: getattr(motor, key) for key in kind.numbers()}
        limit = motor.limit if motor.circuit is not None else ""  # it would need a loop
        return {
            key: value
            for key, value in values.items()
            if value is not None and key not in ("rotor_inertia", limit)
        }

    return draw


def declared(kind: type[Part]) -> Callable[[Rng], Numbers]:
    """Return what draws a part by the usual values that it declares; half of what may be absent."""

    def draw(rng: Rng) -> Numbers:
        drawn: Numbers = {}
        for key, one in kind.numbers().items():
            if one.default is REQUIRED:
                assert one.typical, f"{kind.__name__}.{key} states no usual values (typical=)"
            if one.typical and (one.default is REQUIRED or rng.random() < 0.5):
                low, high = one.typical
                drawn[key] = scaled(rng, low, high) if low > 0.0 else float(rng.uniform(low, high))
        return drawn

    return draw


# By the name of the Python class. Other motors are drawn as they are sized, other parts by the
# usual values that they declare.
DRAWS: dict[str, Callable[[Rng], Numbers]] = {
    "DcMotor": _dc,
    "Pmsm": _pmsm,
    "TorqueMotor": _torque,
    "CurrentMotor": _current,
    "RigidGear": _gear,
    "ElasticGear": _elastic,
    "ProgressiveGear": _progressive,
    "BacklashGear": _backlash,
    "KinematicErrorGear": _kinematic_error,
    "EndStops": _stops,
    "Cogging": _cogging,
    "LinkLuGre": _lugre,
    "RotorLuGre": _rotor_lugre,
    "TorqueTable": _torque_table,
    "CurrentLoop": _current_loop,
    "FieldOrientedLoop": _current_loop,
    "TorqueRipple": _ripple,
    "Brake": _brake,
    "LinkFriction": _law(0.6, 0.1),
    "LinkStribeck": _law(0.6, 0.1, stribeck=0.2),
    "LinkLoadFriction": _law(0.6, 0.1, load=0.2),
    "RotorFriction": _law(0.01, 1e-5),
    "RotorStribeck": _law(0.01, 1e-5, stribeck=6.0),
    "RotorLoadFriction": _law(0.01, 1e-5, load=0.2),
}
DRAWS = {
    **{kind.__name__: declared(kind) for kind in PARTS},
    **{kind.__name__: sized(kind) for kind in MOTORS},
    **DRAWS,
}


def drawn_joint(rng: Rng) -> Numbers:
    """Return the scene's section of a joint with random parts."""
    joint: Numbers = {}
    if rng.random() < 0.6:
        speed = scaled(rng, 0.05, 0.5)
        joint["friction"] = friction(rng, scaled(rng, 0.2, 2.0), 1.5, 0.1, speed)
    if rng.random() < 0.9:
        motor = MOTORS[rng.integers(len(MOTORS))]
        gear = GEARS[rng.integers(len(GEARS))]
        joint["motor"] = {"kind": motor.kind, **DRAWS[motor.__name__](rng), **_rotor(rng)}
        joint["gear"] = DRAWS[gear.__name__](rng)
    for extra in EXTRAS:
        if rng.random() < 0.3:
            place = joint
            *above, key = extra.section.split(".")
            if above and above[0] not in joint:
                continue
            for section in above:
                place = place[section]
            place[key] = DRAWS[extra.__name__](rng)
    return joint


def add_surroundings(rng: Rng, scene: Numbers) -> None:
    """Add what acts on other parts: decorators of motors, brakes, a wrench."""
    for joint in scene["joints"].values():
        motor = joint.get("motor")
        if motor is None:
            continue
        for kind in DECORATORS[::-1]:
            if kind not in LOOPS and _fits(kind, joint) and rng.random() < 0.3:
                motor[kind.section.rpartition(".")[2]] = DRAWS[kind.__name__](rng)
        if rng.random() < 0.2:
            joint["brake"] = _brake(rng)
    scene["external_wrench"] = bool(rng.random() < 0.3)


def _fits(kind: type[Decorator], joint: Numbers) -> bool:
    """Return whether a decorator goes around the motor of a joint."""
    motor = read_motor(Section(joint["motor"], "mixture"))
    drawn = DRAWS[kind.__name__](np.random.default_rng(0))
    try:
        kind.read(Section(drawn, "mixture")).check_motor(motor, Section(joint, "mixture"))
    except Refusal:
        return False
    return True


def write_mixture(folder: Path, seed: int) -> Path:
    """Write the scene of a mixture and return its path."""
    rng = np.random.default_rng([seed, 4242])
    urdf = random_chain_urdf(rng, 2)
    joints = {name: drawn_joint(rng) for name in moving_joints(urdf)}
    scene: Numbers = {"joints": joints}
    add_surroundings(np.random.default_rng([seed, 4243]), scene)
    return write_scene(folder, urdf, joints, external_wrench=scene["external_wrench"])


def drawn_alone(part: type[Part], seed: int) -> Numbers:
    """Return the scene's section of a joint without friction and limits but for one part."""
    rng = np.random.default_rng([seed, 4244, *part.__name__.encode()])
    motor: Numbers = {
        "resistance": 1.0, "inductance": 2e-3, "torque_constant": 0.05, "back_emf_constant": 0.05,
        "rotor_inertia": 1e-4,
    }  # fmt: skip
    for kind in MOTORS:
        if part in LOOPS and kind.kind == part.around_kind:
            motor = {"kind": kind.kind, "rotor_inertia": 1e-4, **DRAWS[kind.__name__](rng)}
    joint: Numbers = {"motor": motor, "gear": {"ratio": 0.02, "stiffness": 3e3, "damping": 2.0}}
    drawn = DRAWS[part.__name__](rng)
    if issubclass(part, Motor):
        joint["motor"] = {"kind": part.kind, "rotor_inertia": 1e-4, **drawn}
    elif issubclass(part, Gear):
        joint["gear"] = drawn
    else:
        *above, key = part.section.split(".")
        (joint[above[0]] if above else joint)[key] = drawn
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
class Verdict:
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
    def in_order(self) -> bool:
        """Whether the positions converge as claimed."""
        return self.note != "" or self.order >= ORDER or self.differences[1] < RESOLVED

    @property
    def balanced(self) -> bool:
        """Whether the energy balance closes as claimed."""
        falls = self.left[-1] < self.left[0] / 2 ** (2 * ORDER) if self.left else False
        return self.note != "" or falls or self.left[-1] < BALANCED

    @property
    def alike(self) -> bool:
        """Whether lanes go as machines alone."""
        return self.note != "" or self.lanes < AS_ALONE

    @property
    def claims(self) -> dict[str, bool]:
        """Return all claims by name."""
        return {"order": self.in_order, "balance": self.balanced, "lanes": self.alike}


def commands(scene: Scene, seed: int) -> np.ndarray:
    """Return commands (ROWS, N) that jump, in the unit of each motor."""
    rng = np.random.default_rng([seed, 77])
    sizes = {"V": 12.0, "N m": 0.3, "A": 6.0}
    size = np.array([sizes[joint.unit] if joint.motor else 0.0 for joint in scene.joints])
    rows: np.ndarray = rng.uniform(-1.0, 1.0, (ROWS, len(size))) * size
    rows[BRAKED] = 0.0  # which is what motors without power get
    return rows


def push(plant: Plant, seed: int) -> None:
    """Let a wrench act on the last link, if the mixture knows wrenches."""
    if plant.scene.external_wrench:
        force, moment = np.random.default_rng([seed, 78]).normal(0.0, 5.0, (2, 3)).tolist()
        plant.set_external_wrench(plant.scene.chain.joints[-1].link, ExternalWrench(force, moment))


def run(scene: Scene, seed: int, rows: np.ndarray, steps: int) -> tuple[np.ndarray, float]:
    """Return positions after each row, and what is left of the energy, of what was exchanged."""
    plant = Plant(scene)
    push(plant, seed)
    began, given, exchanged, q = plant.energy, 0.0, 1e-3, []
    for k, row in enumerate(rows):
        plant.powered = not BRAKED.start <= k < BRAKED.stop  # which brakes follow
        flow = plant.advance_metered(row, steps)
        given += float((flow.given - flow.dissipated).sum())
        exchanged += float(np.abs(flow.given).sum() + np.abs(flow.dissipated).sum())
        q.append(plant.state.q)
    return np.array(q), abs(plant.energy - began - given) / exchanged


def judge(seed: int) -> Verdict:
    """Draw a mixture and hold the claims against it."""
    with tempfile.TemporaryDirectory() as folder:
        file = write_mixture(Path(folder), seed)

        def scene(steps: int, events: str = "located") -> Scene:
            return load_scene(file, {"integrator.dt": PERIOD / steps, "integrator.events": events})

        first = scene(STEPS[0])
        parts = sorted({type(part).__name__ for joint in first.joints for part in joint.parts})
        if first.external_wrench:
            parts.append("ExternalWrench")
        rows = commands(first, seed)
        try:
            verdict, _ = converge(seed, parts, lambda steps: run(scene(steps), seed, rows, steps))
            if seed % 3 == 0:
                verdict = replace(verdict, lanes=lanes_apart(scene(STEPS[1], "step"), seed, rows))
        except Diverged as fault:
            return Verdict(seed, parts, 0.0, (0.0, 0.0), (), (), 0.0, f"Diverged: {fault.joint}")
    return verdict


def converge(
    seed: int, parts: list[str], run_in: Callable[[int], tuple[np.ndarray, float]]
) -> tuple[Verdict, np.ndarray]:
    """Run in smaller and smaller steps until order shows; return that and the finest positions.

    Args:
        seed: of the mixture.
        parts: their names.
        run_in: positions after each row, and what is left of the energy, by steps in a period.
    """
    steps, runs = STEPS[-1], [run_in(steps) for steps in STEPS]
    verdict = _verdict(seed, parts, runs, STEPS)
    while not (verdict.in_order and verdict.balanced) and 2 * steps <= FINEST:
        steps *= 2
        runs = [*runs[1:], run_in(steps)]
        verdict = _verdict(seed, parts, runs, (steps // 4, steps // 2, steps))
    return verdict, runs[-1][0]


def _verdict(
    seed: int, parts: list[str], runs: list[tuple[np.ndarray, float]], steps: tuple[int, ...]
) -> Verdict:
    d = [float(np.abs(a - b).max()) for (a, _), (b, _) in pairwise(runs)]
    order = float(np.log2(d[0] / d[1])) if d[1] > 0.0 < d[0] else 2.0
    return Verdict(seed, parts, order, (d[0], d[1]), tuple(left for _, left in runs), steps, 0.0)


def lanes_apart(scene: Scene, seed: int, rows: np.ndarray) -> float:
    """Return by how much machines side by side differ from the same machines alone."""
    fleet, worst = Fleet(scene, LANES), 0.0
    factors = 1.0 - 0.1 * np.arange(LANES)
    for lane in range(LANES):
        push(fleet[lane], seed)
    q = fleet.run(rows[:, None, :] * factors[None, :, None], STEPS[1])
    for lane, factor in enumerate(factors):
        alone = Plant(scene)
        push(alone, seed)
        moved = alone.run(rows * factor, STEPS[1])
        worst = max(worst, float(np.abs(q[:, lane] - moved).max()))
    return worst
