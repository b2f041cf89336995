"""A gas spring on a link: torque by geometry, energy that is kept, and the order of the motion."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest
from machines import GANTRY, GRAVITY, MOVED, gantry_urdf, write_scene
from scipy.integrate import solve_ivp

from arm_emulator import Plant, Refusal, load_scene

PUSHES = {"base_distance": 0.4, "link_distance": 0.15, "angle": -0.8, "force": 300.0,
          "length": 0.5, "stiffness": 400.0}  # fmt: skip
GAS = {"base_distance": 0.4, "link_distance": 0.15, "angle": 0.6, "length": 0.4, "gas_column": 0.3}
SPRINGS = {"straight": PUSHES, "gas that pulls": GAS | {"force": -250.0},
           "gas that pushes": GAS | {"force": 250.0}}  # fmt: skip
Spring = dict[str, float]


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


def test_links_swing_in_their_springs_with_order_2_and_keep_their_energy(tmp_path: Path) -> None:
    """The joints of a gantry do not feel each other; each has a spring and a weight of its own."""
    joints = {
        name: {"counterbalance": spring}
        for name, spring in zip(GANTRY, SPRINGS.values(), strict=True)
    }
    scene = load_scene(
        write_scene(
            tmp_path, gantry_urdf(), joints, gravity=GRAVITY, energy_flow=True, servo_period=1e-2,
            integrator={"scheme": "rosenbrock", "dt": 1e-3},
        )
    )  # fmt: skip
    rng = np.random.default_rng(1)
    for _ in range(4):
        q0, v0 = rng.uniform(-2.0, 2.0, (2, 3))
        truth = [
            solve_ivp(
                lambda t, x, spring=spring, M=M, g=g: [x[1], torque(x[0], spring) / M + g],
                (0.0, 1.0), [q, v], "DOP853", rtol=1e-12, atol=1e-12,
            ).y[0, -1]
            for spring, M, g, q, v in zip(SPRINGS.values(), MOVED, GRAVITY, q0, v0, strict=True)
        ]  # fmt: skip
        errors, gained = [], []
        for steps in (10, 20, 40):
            integrator = dataclasses.replace(scene.integrator, dt=1e-2 / steps)
            plant = Plant(dataclasses.replace(scene, integrator=integrator))
            plant.reset(q0, v0)
            before = plant.energy
            plant.advance(np.zeros(3), 100 * steps)
            errors.append(np.abs(plant.state.q - truth))
            gained.append(abs(plant.energy - before))
        assert np.log2(errors[1] / errors[2]) == pytest.approx(2.0, abs=0.2), errors
        assert errors[-1].max() < 1e-4, errors
        assert gained[-1] < max(gained[0] / 10.0, 1e-9), gained


def test_a_spring_that_could_vanish_is_refused() -> None:
    for bad, answer in (
        (PUSHES | {"link_distance": 0.401}, r"link_distance must differ by 0\.004 m"),
        (GAS | {"force": -9.0, "gas_column": 0.15}, r"gas_column must be >= 0\.1515 m"),
        (GAS | {"force": 9.0, "gas_column": 0.15}, r"gas_column must be >= 0\.1515 m"),
        (GAS | {"force": 9.0, "stiffness": 1.0}, "stiffness must be absent with gas_column"),
    ):
        with pytest.raises(Refusal, match=rf"counterbalance\.{answer}"):
            load_scene("three_axis", {"joints.elbow.counterbalance": bad})
