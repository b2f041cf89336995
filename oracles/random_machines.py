"""The claims about order and energy, held against random machines that stick and meet limits.

Each machine is a random chain of one to three links under gravity, moved by voltages that jump. It
has a mixture of motors with and without inductance and limits, of rigid, elastic and progressive
gears, and of dry friction. Claims, for rosenbrock and extrapolated with events located:

- the error at a tenth of the step follows the scheme's order, or `Diverged` is raised;
- the residual of energy, given - stored - dissipated, falls with the scheme's order. At steps of 1
  us it is below 1e-9 of the exchanged energy, times (r / 1000)^2 for machines of a faster rate r.

The truth is oracles/event_reference.py's.
"""

from __future__ import annotations

import math
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import yaml

from arm_emulator import Diverged, Plant, Scene, load_scene
from arm_emulator.base.arrays import Array
from arm_emulator.machine.schemes.known import KNOWN, LOCATING_SCHEMES
from oracles.event_reference import solve_with_events
from oracles.random_chain import write_random_chain
from oracles.reference import ReferenceMachine

PERIOD, ROWS = 0.02, 6  # s, that each voltage is held, and how many of them
STEP_OF_RATE = 0.1  # the coarse step times the machine's fastest rate
MICROSECOND = 1e-6  # s
# By how much errors fall at least, from a step to its tenth, by the scheme's order; for first order
# an event may lie well in the coarse step and badly in the fine one.
FALLS = {1: 10**0.5, 2: 10**1.7}
# rad; below it the error is the reference's: 1e-12 a step, in some thousand steps.
RESOLVED = 1e-10
# Of the energy exchanged, at steps of 1 us, for machines up to this rate [1/s]. Transients of a
# rate r are off by a part of (h r)^2; drawn are rates of up to 2e4 1/s.
BALANCED, SLOW = 1e-9, 1e3
ROUNDED = 1e-12  # of the energy exchanged: what sums of 1e5 parts lose to rounding


@dataclass(frozen=True)
class MachineVerdict:
    """Result of one machine with one scheme."""

    seed: int
    scheme: str
    joints: int
    events: int  # that the reference found
    rate: float  # 1/s, the fastest
    steps: int  # in a period, coarse; the fine ones are ten times as many
    errors: tuple[float, float]  # rad or m, coarse and fine
    left: tuple[float, float, float]  # of energy, of what was exchanged: coarse, fine, 1 us
    note: str = ""

    @property
    def is_in_order(self) -> bool:
        """Whether the fine error is that of the scheme's order."""
        falls = FALLS[KNOWN[self.scheme].order]
        return self.note != "" or self.errors[1] < max(RESOLVED, self.errors[0] / falls)

    @property
    def is_balance_in_order(self) -> bool:
        """Whether the residual of energy is that of the scheme's order."""
        falls = FALLS[KNOWN[self.scheme].order]
        return self.note != "" or self.left[1] < max(ROUNDED, self.left[0] / falls)

    @property
    def is_balanced(self) -> bool:
        """Whether energy balances at 1 us."""
        return self.note != "" or self.left[2] < BALANCED * max(1.0, self.rate / SLOW) ** 2

    @property
    def claims(self) -> dict[str, bool]:
        """Return all claims by name."""
        return {
            f"{self.scheme}: error in order": self.is_in_order,
            f"{self.scheme}: balance in order": self.is_balance_in_order,
            f"{self.scheme}: balanced at 1 us": self.is_balanced,
        }


def write_machine(folder: Path, seed: int) -> tuple[Path, Array]:
    """Write a random machine into `folder`; return its scene's file and its voltages."""
    rng = np.random.default_rng(seed)
    urdf = write_random_chain(rng, int(rng.integers(1, 4)))
    names = [name for name in pin.buildModelFromXML(urdf).names if name != "universe"]
    joints = {name: _draw_joint(rng) for name in names}
    if not any("motor" in joint for joint in joints.values()):
        joints[names[0]] |= {"motor": _draw_motor(rng), "gear": _draw_gear(rng)}
    apart = np.random.default_rng([seed, 1])  # so that all else is drawn as without
    for joint in joints.values():
        _make_progressive(apart, joint.get("gear", {}))
    data: dict[str, Any] = {
        "name": f"random_{seed}",
        "urdf": "robot.urdf",
        "tool": "base",
        "supply_voltage": 48.0,
        "joints": joints,
        "integrator": {"dt": 1e-4},
        "servo_period": PERIOD,
        "energy_flow": True,
    }
    if rng.random() < 0.5:
        data["gravity"] = [0.0, 0.0, -9.81]
    (folder / "robot.urdf").write_text(urdf)
    file = folder / "scene.yaml"
    file.write_text(yaml.safe_dump(data))
    return file, rng.uniform(-20.0, 20.0, size=(ROWS, len(names)))


def _draw_joint(rng: np.random.Generator) -> dict[str, Any]:
    joint: dict[str, Any] = {"friction": {"viscous": float(rng.uniform(0.0, 1.0))}}
    if rng.random() < 0.7:
        Dc = float(rng.uniform(0.5, 5.0))
        joint["friction"]["coulomb"] = Dc
        if rng.random() < 0.5:
            joint["friction"]["breakaway"] = Dc * float(rng.uniform(1.0, 1.6))
    if rng.random() < 0.9:
        joint |= {"motor": _draw_motor(rng), "gear": _draw_gear(rng)}
    return joint


def _draw_motor(rng: np.random.Generator) -> dict[str, float]:
    motor = {
        "resistance": float(rng.uniform(0.5, 2.0)),
        "torque_constant": 0.05,
        "back_emf_constant": float(rng.choice([0.05, 0.04])),
        "rotor_inertia": float(10 ** rng.uniform(-5, -3.5)),
    }
    if rng.random() < 0.65:
        motor["inductance"] = float(10 ** rng.uniform(-4, -2.5))
    if rng.random() < 0.6:
        motor["current_limit"] = float(rng.uniform(1.0, 6.0))
    return motor


def _draw_gear(rng: np.random.Generator) -> dict[str, float]:
    gear = {"ratio": float(rng.uniform(0.01, 0.03))}
    if rng.random() < 0.6:
        gear["stiffness"] = float(10 ** rng.uniform(3.0, 4.5))
        gear["damping"] = float(rng.choice([0.0, rng.uniform(1.0, 30.0)]))
    return gear


def _make_progressive(rng: np.random.Generator, gear: dict[str, float]) -> None:
    """Make some elastic gears progressive: the cube has a share of 20 N m."""
    if "stiffness" in gear and rng.random() < 0.4:
        share = float(10 ** rng.uniform(-1.0, 0.5))
        gear["cubic_stiffness"] = share * gear["stiffness"] ** 3 / 20.0**2


def judge_machine(seed: int, schemes: tuple[str, ...] = LOCATING_SCHEMES) -> list[MachineVerdict]:
    """Hold one machine against the claims."""
    with tempfile.TemporaryDirectory() as folder:
        file, voltages = write_machine(Path(folder), seed)
        scene = load_scene(file)
        equations = ReferenceMachine(scene, smooth=False)
        rate = equations.compute_fastest_rate(equations.make_rest_state(scene.start, None))
        truth, events = solve_with_events(scene, voltages, PERIOD)
        steps = math.ceil(PERIOD * max(rate, 1e3) / STEP_OF_RATE)
        verdicts = []
        for scheme in schemes:
            about = (seed, scheme, len(scene.joints), events, rate)
            verdict = _judge_scheme(file, scheme, voltages, truth, about, steps)
            # Where the coarse error is small by chance, as its parts cancel, the next decides.
            if not (verdict.is_in_order and verdict.is_balance_in_order):
                verdict = _judge_scheme(file, scheme, voltages, truth, about, 10 * steps)
            verdicts.append(verdict)
        return verdicts


def _judge_scheme(
    file: Path,
    scheme: str,
    voltages: Array,
    truth: Array,
    about: tuple[int, str, int, int, float],
    steps: int,
) -> MachineVerdict:
    try:
        runs = [
            run_rows(_load_with(file, scheme, PERIOD / n), voltages, n)
            for n in (steps, 10 * steps, round(PERIOD / MICROSECOND))
        ]
    except Diverged as fault:
        return MachineVerdict(
            *about, steps, (math.nan, math.nan), (math.nan, math.nan, math.nan), str(fault)
        )
    (q, left), (q_fine, left_fine), (_, left_there) = runs
    errors = float(np.abs(q - truth).max()), float(np.abs(q_fine - truth).max())
    return MachineVerdict(*about, steps, errors, (left, left_fine, left_there))


def _load_with(file: Path, scheme: str, dt: float) -> Scene:
    events = "located" if scheme in LOCATING_SCHEMES else "step"
    integrator = {"scheme": scheme, "dt": dt, "events": events}
    return load_scene(file, {"integrator": integrator})


def run_rows(scene: Scene, voltages: Array, steps: int) -> tuple[Array, float]:
    """Return the links' positions after each row, and what part of the energy is left over."""
    plant = Plant(scene)
    before, supplied, dissipated, exchanged, q = plant.energy, 0.0, 0.0, 0.0, []
    for row in voltages:
        flow = plant.advance_metered(row, steps)
        supplied += float(flow.supplied.sum())
        dissipated += float(flow.dissipated.sum())
        exchanged += float(np.abs(flow.supplied).sum() + flow.dissipated.sum())
        q.append(plant.state.q)
    return np.array(q), abs(plant.energy - before - supplied + dissipated) / exchanged
