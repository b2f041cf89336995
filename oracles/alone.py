"""Random mixtures in which each law stands alone, against an independent solution.

These mixtures show defects that a mixture of many parts hides. Each joint has one law of friction
at most, at its link or at its rotor, dry or not. (oracles/mixtures.py draws all laws at once,
always one that is dry.) Every other command is 0; gears are rigid, elastic or have gaps. Claims:

- with events located the motion is that of oracles/smoothed_reference.py, which decides no modes;
  differences between runs fall with the square of the step;
- with events at the ends of steps, in all schemes, the error falls as the step;
- the residual of energy, given - stored - dissipated, falls alike;
- four machines side by side move as each of them alone (every fourth mixture);
- none diverges.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from arm_emulator import Diverged, Scene, load_scene
from arm_emulator.base.arrays import Array
from arm_emulator.machine.parts.frictions.brake import Brake
from arm_emulator.machine.parts.frictions.lugre import LinkLuGre, RotorLuGre
from arm_emulator.machine.parts.gears.backlash_gear import BacklashGear
from arm_emulator.machine.parts.gears.elastic_gear import ElasticGear
from arm_emulator.machine.parts.gears.gear import RigidGear
from arm_emulator.machine.parts.gears.progressive_gear import ProgressiveGear
from arm_emulator.machine.parts.joint_effects.end_stops import EndStops
from arm_emulator.machine.parts.motors.current_motor import CurrentMotor
from arm_emulator.machine.parts.motors.dc_motor import DcMotor
from arm_emulator.machine.parts.motors.torque_motor import TorqueMotor
from arm_emulator.machine.schemes.known import LOCATING_SCHEMES, SCHEMES
from oracles import mixtures
from oracles.mixtures import BRAKED, PERIOD, STEPS, Numbers, Rng, run_rows
from oracles.part_truths import draw_part, draw_scaled
from oracles.random_chain import list_moving_joints, write_random_chain
from oracles.smoothed_reference import InputRow, SmoothedMachine, Smoothing

ROWS = 14  # commands, each for a period
# Steps in a row where events are taken at their ends; an error depends on the place of events in a
# step. None of the coarse ones divides another. Errors are smaller in the fine ones; the finer are
# for small errors of the coarse ones by chance.
COARSE, FINE, FINER = (20, 28, 40), (320, 640), (1280, 2560)
FALLS = 4.0  # 16 and 64 are what is claimed
# rad or m: of the reference, in which a shaft that sticks creeps, and of event times
RESOLVED, ROUNDED = 1e-6, 1e-8
SHARPER = Smoothing(speed=2e-6, resistance=1e6, rtol=1e-10)


def _draw_friction(rng: Rng, name: str, dry: float, speed: float) -> Numbers:
    breakaway = {"coulomb": dry, "breakaway": dry * float(rng.uniform(1.05, 1.6))}
    return {
        "viscous": {"viscous": 0.1 * dry / speed},
        "coulomb": {"coulomb": dry},
        "breakaway": breakaway,
        "stribeck": {**breakaway, "stribeck": speed},
        "load": {"load": float(rng.uniform(0.05, 0.5))},
        "load and stribeck": {**breakaway, "stribeck": speed, "load": 0.2},
    }[name]


# Of parts that the reference solves; dc motors, with and without their limits, as often as others.
MOTORS = (DcMotor, DcMotor, TorqueMotor, CurrentMotor)
GEARS = (RigidGear, ElasticGear, ProgressiveGear, BacklashGear)
FRICTIONS = ("viscous", "coulomb", "breakaway", "stribeck", "load", "load and stribeck")


def draw_joint(rng: Rng) -> Numbers:
    """Return the scene's section of a joint: motor, gear, and one law of friction at most."""
    joint: Numbers = {}
    law = str(rng.choice(("none", "lugre", *FRICTIONS)))
    at_rotor = bool(rng.random() < 0.5)
    motor = MOTORS[rng.choice(len(MOTORS))]
    joint["motor"] = {
        **mixtures.draw_motor(rng, motor),
        "rotor_inertia": draw_scaled(rng, 5e-5, 3e-4),
    }
    joint["gear"] = draw_part(GEARS[rng.choice(len(GEARS))], rng)
    if law == "lugre":
        place = joint["motor"] if at_rotor else joint
        place["lugre"] = draw_part(RotorLuGre if at_rotor else LinkLuGre, rng)
    elif law != "none":
        dry, speed = (
            (draw_scaled(rng, 0.003, 0.03), draw_scaled(rng, 2.0, 20.0))
            if at_rotor
            else (draw_scaled(rng, 0.2, 2.0), draw_scaled(rng, 0.05, 0.5))
        )
        (joint["motor"] if at_rotor else joint)["friction"] = _draw_friction(rng, law, dry, speed)
    for part in (EndStops, Brake):
        if rng.random() < 0.25:
            joint[part.section] = draw_part(part, rng)
    return joint


def write_sample(folder: Path, seed: int) -> Path:
    """Write the scene of a mixture and return its path."""
    rng = np.random.default_rng([seed, 6161])
    urdf = write_random_chain(rng, int(rng.integers(1, 3)))
    joints = {name: draw_joint(rng) for name in list_moving_joints(urdf)}
    return mixtures.write_scene(folder, urdf, joints)


def draw_commands(scene: Scene, seed: int) -> Array:
    """Return commands (ROWS, N) that jump, half of them 0, all of them in the first rows."""
    rng = np.random.default_rng([seed, 62])
    rows = mixtures.draw_commands(scene, seed)[:ROWS]
    rows[rng.random(rows.shape) < 0.5] = 0.0
    rows[: int(rng.integers(0, 4))] = 0.0
    return rows


def compute_truth(scene: Scene, rows: Array, smoothing: Smoothing) -> Array:
    """Return the reference's positions after each row."""
    dt = PERIOD / STEPS[0]  # that brakes follow in whole steps of
    braked = [BRAKED.start <= k < BRAKED.stop for k in range(len(rows))]
    changes: dict[int, list[tuple[float, bool]]] = {}
    for j, joint in enumerate(scene.joints):
        if joint.brake is None:
            continue
        changes[j] = [
            (BRAKED.start * PERIOD + joint.brake.close_delay, True),
            (BRAKED.stop * PERIOD + joint.brake.release_delay, False),
        ]
        if changes[j][0][0] > BRAKED.stop * PERIOD - 0.5 * dt:
            changes[j] = []  # wanted no more before it has closed
    assert any(braked)
    instants = sorted({round(t / dt) for own in changes.values() for t, _ in own})
    pieces, ends = [], []
    per_row = round(PERIOD / dt)
    for k, row in enumerate(rows):
        cuts = [k * per_row, *(t for t in instants if k * per_row < t < (k + 1) * per_row)]
        for begin, end in zip(cuts, [*cuts[1:], (k + 1) * per_row], strict=True):
            closed = tuple(
                any(on and round(t / dt) <= begin for t, on in changes.get(j, []))
                and not any(not on and round(t / dt) <= begin for t, on in changes.get(j, []))
                for j in range(len(scene.joints))
            )
            pieces.append(InputRow(row, closed, (end - begin) * dt))
        ends.append(len(pieces) - 1)
    return SmoothedMachine(scene, smoothing).compute_positions(pieces)[ends]


@dataclass(frozen=True)
class AloneVerdict:
    """Result of one mixture."""

    seed: int
    parts: list[str]
    schemes: tuple[str, str]  # with events located, and at the ends of steps
    way: float = 0.0  # rad or m
    off: float = 0.0  # rad or m, between the finest located run and the truth
    truth: float = 0.0  # rad or m, by how much that changes with sharper jumps, where it was asked
    located: mixtures.MixtureVerdict | None = None
    errors: tuple[float, float] = (0.0, 0.0)  # rad or m, at the ends of steps: coarse and fine
    left: tuple[float, float] = (0.0, 0.0)  # of the energy exchanged, there
    lanes: float = 0.0  # rad or m, by which lanes differ from machines alone
    note: str = ""

    @property
    def is_true(self) -> bool:
        """Whether the motion is that of the reference."""
        own = self.located.differences[1] if self.located else 0.0
        return self.off < RESOLVED + 2.0 * (self.truth + own)

    @property
    def is_of_first_order(self) -> bool:
        """Whether the error falls as the step where events are not located."""
        # The located run that they are compared with has an error of its own.
        own = self.located.differences[1] if self.located else 0.0
        return self.errors[1] < max(self.errors[0] / FALLS, ROUNDED + own)

    @property
    def is_balanced(self) -> bool:
        """Whether the residual of energy falls as the step there."""
        return self.left[1] < max(self.left[0] / FALLS, mixtures.BALANCED)

    @property
    def claims(self) -> dict[str, bool]:
        """Return all claims by name."""
        return {
            "true": self.is_true,
            "located: order 2": self.located is None or self.located.is_in_order,
            "located: balance": self.located is None or self.located.is_balanced,
            "step: order 1": self.is_of_first_order,
            "step: balance": self.is_balanced,
            "lanes": self.lanes == 0.0,
            "held": self.note == "",
        }


def judge_mixture(seed: int) -> AloneVerdict:
    """Draw a mixture and hold the claims against it."""
    schemes = LOCATING_SCHEMES[seed % 2], SCHEMES[seed // 2 % len(SCHEMES)]
    with tempfile.TemporaryDirectory() as folder:
        file = write_sample(Path(folder), seed)

        def load_mixture(steps: int, events: str) -> Scene:
            scheme = schemes[0 if events == "located" else 1]
            integrator = {"scheme": scheme, "events": events, "dt": PERIOD / steps}
            return load_scene(file, {"integrator": integrator})

        first = load_mixture(STEPS[0], "located")
        parts = sorted({type(part).__name__ for joint in first.joints for part in joint.parts})
        rows = draw_commands(first, seed)
        truth, sharper = compute_truth(first, rows, Smoothing()), 0.0
        try:
            located, q = mixtures.find_converged(
                seed,
                parts,
                lambda steps: run_rows(load_mixture(steps, "located"), seed, rows, steps),
            )
            if np.abs(q - truth).max() > RESOLVED:
                blunt, truth = truth, compute_truth(first, rows, SHARPER)
                sharper = float(np.abs(truth - blunt).max())
            coarse, fine, finer = (
                _find_worst([run_rows(load_mixture(n, "step"), seed, rows, n) for n in steps], q)
                for steps in (COARSE, FINE, FINER)
            )
            error, left = (
                b if a > c / FALLS else a for a, b, c in zip(fine, finer, coarse, strict=True)
            )
            lanes = 0.0
            if seed % 4 == 0:
                lanes = mixtures.compare_lanes(load_mixture(COARSE[1], "step"), seed, rows)
        except Diverged as fault:
            return AloneVerdict(seed, parts, schemes, note=str(fault))
    return AloneVerdict(
        seed, parts, schemes,
        way=float(np.abs(truth - first.start).max()), off=float(np.abs(q - truth).max()),
        truth=sharper, located=located, errors=(coarse[0], error), left=(coarse[1], left),
        lanes=lanes,
    )  # fmt: skip


def _find_worst(runs: list[tuple[Array, float]], q: Array) -> tuple[float, float]:
    return max(float(np.abs(own - q).max()) for own, _ in runs), max(left for _, left in runs)
