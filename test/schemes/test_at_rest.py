"""Machines at rest without a command, with each law of friction alone."""

import itertools
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from draws import some, with_slow
from machines import ROTOR, write_scene

from arm_emulator import Plant, load_scene
from oracles.at_rest import FRICTIONS, INSTANT, PARTS, PLACES, RestCase, judge_poses, load_equations
from oracles.random_chain import list_moving_joints, write_random_chain
from oracles.reference import make_links_model

DRY, LOADED = ("viscous", "breakaway"), ("load", "load and coulomb")
# Laws of one kind share a library.
CASES = [
    ("rotor", DRY, "rosenbrock", "step", True),
    ("link", ("breakaway",), "extrapolated", "located", False),
    ("rotor", ("coulomb",), "rosenbrock", "step", True),
    ("rotor", LOADED, "implicit", "step", True),
    ("rotor", LOADED, "implicit", "step", False),
    ("link", LOADED, "rosenbrock", "located", False),
    *((place, (law,), "rosenbrock", "located", False) for place in PLACES for law in FRICTIONS),
]


@pytest.mark.parametrize(
    ("place", "frictions", "scheme", "events", "weightless"), with_slow(some(CASES, 3), 1)
)
def test_joints_rest_where_friction_holds_them_and_move_elsewhere(
    place: str, frictions: tuple[str, ...], scheme: str, events: str, weightless: bool
) -> None:
    """Rotors that rub viscously ended as a divergence in 34 of 200 poses without weights."""
    equations = load_equations("three_axis")
    wrong = [
        line
        for law in frictions
        for line in judge_poses(
            RestCase("three_axis", place, law, scheme, events, weightless), 60, equations
        )
    ]
    assert not wrong, wrong


@pytest.mark.slow
@pytest.mark.parametrize("events", some(["located", "step"], 1))
def test_joints_that_break_away_together_are_solved_together(tmp_path: Path, events: str) -> None:
    """Against a trial of all ways in which three joints may rest and slide: one of them holds.

    With this chain, in 1 of 30 draws the joint that is the most overloaded would be driven back by
    another that it draws along.
    """
    rng = np.random.default_rng(3)
    urdf = write_random_chain(np.random.default_rng(2), 3)
    motor = {"kind": "torque", "rotor_inertia": ROTOR}
    joint = {"motor": motor, "gear": {"ratio": 1.0}, "friction": {"coulomb": 1.0}}
    file = write_scene(
        tmp_path, urdf, dict.fromkeys(list_moving_joints(urdf), joint),
        servo_period=PARTS * INSTANT,
        integrator={"scheme": "rosenbrock", "dt": INSTANT, "events": events},
        varied=["joints.*.friction.coulomb"],
    )  # fmt: skip
    scene = load_scene(file)
    plant, model = Plant(scene), make_links_model(scene)
    data = model.createData()
    for _ in range(300):
        q, dry = rng.uniform(-1.5, 1.5, 3), rng.uniform(0.5, 2.0, 3)
        for number, Dc in zip(scene.varied, dry, strict=True):
            plant.set_parameter(number.name, float(Dc))
        torque = rng.normal(0.0, 2.0, 3)
        plant.reset(q)
        plant.advance(torque, PARTS)
        M = pin.crba(model, data, q)
        M = np.triu(M) + np.triu(M, 1).T + ROTOR * np.eye(3)
        a = accelerations_from_rest(M, torque, dry)
        assert plant.state.v / (PARTS * INSTANT) == pytest.approx(a, rel=1e-3, abs=1e-3), (
            f"accelerations at {q.tolist()} under {torque.tolist()} with {dry.tolist()}"
        )
        assert ((plant.state.v == 0.0) == (a == 0.0)).all(), "who rests"


def accelerations_from_rest(M: np.ndarray, torque: np.ndarray, dry: np.ndarray) -> np.ndarray:
    """The only ones that agree with Coulomb's law at each joint."""
    result = []
    for signs in itertools.product((-1.0, 0.0, 1.0), repeat=len(dry)):
        directions = np.array(signs)
        free = directions != 0.0
        a = np.zeros(len(dry))
        a[free] = np.linalg.solve(M[np.ix_(free, free)], (torque - dry * directions)[free])
        holding = torque - M @ a
        if (a[free] * directions[free] > 0.0).all() and (np.abs(holding) <= dry)[~free].all():
            result.append(a)
    assert len(result) == 1, "Coulomb's friction has one solution"
    return result[0]
