"""A gas spring on a link: torque by geometry, energy that is kept, and the order of the motion."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest
from draws import some
from machines import LINK_INERTIA, one_link_urdf, write_scene
from scipy.integrate import solve_ivp

from emulator_node.fleet import Fleet
from emulator_node.plant import Plant
from emulator_node.scene import load_scene
from words.refusal import Refusal

PUSHES = {"base_distance": 0.4, "link_distance": 0.15, "angle": -0.8, "force": 300.0,
          "length": 0.5, "stiffness": 400.0}  # fmt: skip
GAS = {"base_distance": 0.4, "link_distance": 0.15, "angle": 0.6, "length": 0.4, "gas_column": 0.3}
SPRINGS = {"straight": PUSHES, "gas that pulls": GAS | {"force": -250.0},
           "gas that pushes": GAS | {"force": 250.0}}  # fmt: skip
Spring = dict[str, float]


def weighed(folder: Path, spring: Spring = PUSHES) -> Path:
    return write_scene(
        folder, one_link_urdf(), {"joint": {"counterbalance": spring}}, gravity=[0.0, 0.0, -9.81],
        energy_flow=True, servo_period=1e-2, integrator={"scheme": "rosenbrock", "dt": 1e-3},
    )  # fmt: skip


def torque(q: float, spring: Spring) -> float:
    """From the positions of both ends, by the change of their distance."""
    a, b = spring["base_distance"], spring["link_distance"]
    at = q - spring["angle"]
    ends = np.array([b * math.cos(at) - a, b * math.sin(at)])
    along = ends / np.linalg.norm(ends)
    longer = np.linalg.norm(ends) - spring["length"]
    if "gas_column" in spring:  # pressure times volume stays
        volume = spring["gas_column"] + math.copysign(longer, spring["force"] * longer)
        F = spring["force"] * spring["gas_column"] / volume
    else:
        F = spring["force"] - spring["stiffness"] * longer
    return float(F * along @ (b * np.array([-math.sin(at), math.cos(at)])))


@pytest.mark.parametrize("kind", SPRINGS)
def test_a_link_swings_in_its_spring_with_order_2_and_keeps_its_energy(
    tmp_path: Path, kind: str
) -> None:
    rng, spring = np.random.default_rng(1), SPRINGS[kind]
    scene = load_scene(weighed(tmp_path, spring))
    weight = 2.0 * 0.3 * 9.81
    for _ in range(4):
        q0, v0 = float(rng.uniform(-2.0, 2.0)), float(rng.uniform(-2.0, 2.0))
        truth = solve_ivp(
            lambda t, x: [x[1], (torque(x[0], spring) + weight * math.cos(x[0])) / LINK_INERTIA],
            (0.0, 1.0), [q0, v0], "DOP853", rtol=1e-12, atol=1e-12,
        ).y[:, -1]  # fmt: skip
        errors, gained = [], []
        for steps in (20, 40, 80):
            integrator = dataclasses.replace(scene.integrator, dt=1e-2 / steps)
            plant = Plant(dataclasses.replace(scene, integrator=integrator))
            plant.reset([q0], [v0])
            before = plant.energy
            plant.advance([0.0], 100 * steps)
            errors.append(abs(plant.state.q[0] - truth[0]))
            gained.append(abs(plant.energy - before))
        assert math.log2(errors[1] / errors[2]) == pytest.approx(2.0, abs=0.2), errors
        assert errors[-1] < 1e-4, errors
        assert gained[-1] < max(gained[0] / 10.0, 1e-9), gained


@pytest.mark.parametrize("kind", some(SPRINGS, 2)[1:])
def test_balanced_arms_in_lanes_move_as_single_ones(tmp_path: Path, kind: str) -> None:
    scene, q = load_scene(weighed(tmp_path, SPRINGS[kind])), np.linspace(-2.0, 2.0, 9)[:, None]
    moved = Fleet(scene, 9, q=q).run(np.zeros((10, 9, 1)), 20)
    for arm in range(9):
        plant = Plant(scene)
        plant.reset(q[arm])
        alone = plant.run(np.zeros((10, 1)), 20)
        np.testing.assert_allclose(moved[:, arm], alone, rtol=0, atol=1e-11, err_msg=f"arm {arm}")


def test_a_spring_that_could_vanish_is_refused() -> None:
    for bad, says in (
        (PUSHES | {"link_distance": 0.401}, r"link_distance must differ by 0\.004 m"),
        (GAS | {"force": -9.0, "gas_column": 0.15}, r"gas_column must be >= 0\.1515 m"),
        (GAS | {"force": 9.0, "gas_column": 0.15}, r"gas_column must be >= 0\.1515 m"),
        (GAS | {"force": 9.0, "stiffness": 1.0}, "stiffness must be absent with gas_column"),
    ):
        with pytest.raises(Refusal, match=rf"counterbalance\.{says}"):
            load_scene("three_axis", {"joints.elbow.counterbalance": bad})
