"""A gas spring on a link: torque by geometry, energy that is kept, and the order of the motion."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest
from machines import LINK_INERTIA, one_link_urdf, write_scene
from scipy.integrate import solve_ivp

from emulator_node.fleet import Fleet
from emulator_node.plant import Plant
from emulator_node.scene import load_scene
from words.refusal import Refusal

SPRING = {"base_distance": 0.4, "link_distance": 0.15, "angle": -0.8, "force": 300.0,
          "length": 0.5, "stiffness": 400.0}  # fmt: skip


def weighed(folder: Path) -> Path:
    return write_scene(
        folder, one_link_urdf(), {"joint": {"counterbalance": SPRING}}, gravity=[0.0, 0.0, -9.81],
        energy_flow=True, servo_period=1e-2, integrator={"scheme": "rosenbrock", "dt": 1e-3},
    )  # fmt: skip


def torque(q: float) -> float:
    """From the positions of both ends, by the change of their distance."""
    a, b = SPRING["base_distance"], SPRING["link_distance"]
    at = q - SPRING["angle"]
    ends = np.array([b * math.cos(at) - a, b * math.sin(at)])
    along = ends / np.linalg.norm(ends)
    F = SPRING["force"] - SPRING["stiffness"] * (np.linalg.norm(ends) - SPRING["length"])
    return float(F * along @ (b * np.array([-math.sin(at), math.cos(at)])))


def test_a_link_swings_in_its_spring_with_order_2_and_keeps_its_energy(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    scene = load_scene(weighed(tmp_path))
    weight = 2.0 * 0.3 * 9.81
    for _ in range(4):
        q0, v0 = float(rng.uniform(-2.0, 2.0)), float(rng.uniform(-2.0, 2.0))
        truth = solve_ivp(
            lambda t, x: [x[1], (torque(x[0]) + weight * math.cos(x[0])) / LINK_INERTIA],
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


def test_balanced_arms_in_lanes_move_as_single_ones(tmp_path: Path) -> None:
    scene, q = load_scene(weighed(tmp_path)), np.linspace(-2.0, 2.0, 9)[:, None]
    moved = Fleet(scene, 9, q=q).run(np.zeros((10, 9, 1)), 20)
    for arm in range(9):
        plant = Plant(scene)
        plant.reset(q[arm])
        alone = plant.run(np.zeros((10, 1)), 20)
        np.testing.assert_allclose(moved[:, arm], alone, rtol=0, atol=1e-11, err_msg=f"arm {arm}")


def test_a_spring_that_could_vanish_is_refused() -> None:
    bad = {"joints.elbow.counterbalance": SPRING | {"link_distance": 0.401}}
    with pytest.raises(Refusal, match=r"counterbalance\.link_distance must differ by 0\.004 m"):
        load_scene("three_axis", bad)
