"""Modes kept from step to step are those that every step would determine anew."""

from itertools import product
from typing import Any

import numpy as np
import pytest
from draws import some, with_slow

from arm_emulator import Plant, Scene, load_scene
from arm_emulator.machine.plant.external_wrench import ExternalWrench
from arm_emulator_fleet import Fleet

DT, PERIODS, CALM = 5e-4, 1200, 900  # s; periods, and from which on nothing pushes
STOPS = {"lower": -0.05, "upper": 0.9, "stiffness": 2e3, "damping": 20.0}
DRY = {"viscous": 0.5, "coulomb": 3.0, "breakaway": 4.0}
# Overrides of three_axis: what each of its joints has, and the largest command.
MACHINES: dict[str, tuple[dict[str, Any], float]] = {
    "loops and progressive gears": (
        {"motor.current_limit": 8.0, "motor.current_loop": {"bandwidth": 2000.0},
         "gear.cubic_stiffness": 1e8, "friction": DRY,
         "brake": {"torque": 0.1, "close_delay": 4e-3, "release_delay": 6e-3}}, 8.0),
    "rotors that stick, with play": (
        {"motor.friction": {"coulomb": 0.02, "breakaway": 0.03}, "gear.backlash": 0.002,
         "friction": DRY}, 5.0),
    "ideal currents, behind rigid gears": (
        {"motor": {"kind": "current", "torque_constant": 0.05, "rotor_inertia": 1e-4},
         "gear": {"ratio": 0.01}, "friction": DRY}, 3.0),
    "limits without inductance": (
        {"motor.current_limit": 4.0, "motor.inductance": None, "friction": DRY}, 8.0),
    "laws that vary, behind rigid gears": (
        {"gear": {"ratio": 0.01}, "friction": {**DRY, "stribeck": 0.05, "load": 0.1}}, 5.0),
}  # fmt: skip


def scene_of(name: str, scheme: str, events: str = "located") -> Scene:
    of_joints, _ = MACHINES[name]
    joints = {f"joints.*.{key}": value for key, value in of_joints.items()}
    return load_scene(
        "three_axis",
        {**joints, "joints.*.end_stops": STOPS, "gravity": [0.0, 0.0, -1.0],
         "external_wrench": True, "varied": ["joints.elbow.friction.coulomb"],
         "integrator": {"scheme": scheme, "dt": DT, "events": events}, "servo_period": DT},
    )  # fmt: skip


def draw_command(rng: np.random.Generator, largest: float) -> np.ndarray:
    """Mostly small or none, so that some joints rest, all rest, or lie on their stops."""
    size = largest * rng.choice([0.0, 0.05, 0.3, 1.0], p=[0.3, 0.3, 0.2, 0.2])
    return rng.uniform(-size, size, 3)


CASES = sorted(
    product(some(MACHINES, 3), ("located", "step"), some(["extrapolated", "rosenbrock"], 1)),
    key=lambda case: case != ("rotors that stick, with play", "step", "extrapolated"),
)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "events", "scheme"), with_slow([CASES[1], CASES[0], *CASES[2:]], 1)
)
def test_a_machine_moves_as_a_machine_that_forgets_its_modes_before_every_step(
    name: str, events: str, scheme: str
) -> None:
    """A new machine has kept nothing; commands, wrenches, numbers and power change."""
    scene, rng = scene_of(name, scheme, events), np.random.default_rng(list(MACHINES).index(name))
    largest = MACHINES[name][1]
    keeps = Plant(scene)
    command, moving = np.zeros(3), np.zeros((PERIODS, 3), bool)
    for k in range(PERIODS):
        if rng.random() < 0.03:
            command = draw_command(rng, largest) * (k < CALM)
        if k < CALM and rng.random() < 0.01:
            wrench = ExternalWrench(rng.uniform(-60.0, 60.0, 3) * (rng.random() < 0.5))
            keeps.set_external_wrench("forearm", wrench)
        if rng.random() < 0.01:
            share = rng.uniform(0.5, 1.5)
            keeps.set_parameter("joints.elbow.friction.coulomb", 3.0 * share)
        if rng.random() < 0.01:
            keeps.powered = bool(rng.random() < 0.7)
        forgets = Plant(scene)
        forgets.restore(keeps.save())
        for plant in (keeps, forgets):
            plant.exchange(command)
        assert keeps.save() == forgets.save(), f"period {k}"
        moving[k] = keeps.state.v != 0.0
    at_once = moving.sum(axis=1)
    assert {0, 3} <= {*at_once.tolist()} and ((at_once > 0) & (at_once < 3)).any(), "all kinds"


@pytest.mark.slow
def test_an_arm_that_breaks_away_beside_resting_ones_moves_as_a_single_arm() -> None:
    """Groups in which all rest, some move, and one meets a stop; a push moves an arm at rest."""
    name = "loops and progressive gears"
    scene, rng = scene_of(name, "extrapolated"), np.random.default_rng(7)
    fleet = Fleet(scene, 9, workers=1)
    alone = [Plant(scene) for _ in range(9)]
    rows = np.zeros((9, 3))
    rests = np.zeros(0, int)
    for part in range(60):
        if part % 12 != 11:
            arm = rng.integers(9)
            rows[arm] = draw_command(rng, MACHINES[name][1])
        else:
            rows[:] = 0.0
        if part % 12 == 0:
            push = ExternalWrench(rng.uniform(-60.0, 60.0, 3))
            for plant in (fleet[arm], alone[arm]):
                plant.set_external_wrench("forearm", push)
        periods = 20 if part % 12 != 11 else 2000
        fleet.run(np.broadcast_to(rows, (periods, 9, 3)), 1)
        for arm, plant in enumerate(alone):
            plant.advance(rows[arm], periods)
            single, in_fleet = plant.state, fleet[arm].state
            for number in ("q", "v", "current", "theta_m", "omega_m"):
                assert (getattr(single, number) == getattr(in_fleet, number)).all(), (
                    part,
                    arm,
                    number,
                )
        rests = np.append(rests, sum(not np.any(plant.state.v) for plant in alone[:8]))
    assert 8 in rests and ((rests > 0) & (rests < 8)).any(), "a group rests, or a part of it"
