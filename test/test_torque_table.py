"""Torques over the angle as tables: SciPy's interpolant, its energy, the order of the motion."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from machines import LINK_INERTIA, one_link_urdf, write_scene
from scipy.integrate import solve_ivp
from scipy.interpolate import PchipInterpolator

from emulator_node.fleet import Fleet
from emulator_node.plant import Plant
from emulator_node.scene import Scene, load_scene
from words.refusal import Refusal

WEIGHT = 2.0 * 0.3 * 9.81  # N m, of the link when it is level; it turns downwards


def drawn(seed: int, points: int, periodic: bool) -> dict[str, Any]:
    rng = np.random.default_rng(seed)
    angles = -2.5 + np.cumsum(rng.uniform(0.02, 1.0, points))
    torques = rng.uniform(-5.0, 5.0, points)
    torques[2] = torques[1]  # a piece that is level
    if periodic:
        torques[-1] = torques[0]
    else:
        torques[-1] = abs(torques[-1])  # which drives the link on beyond the end
    return {"angles": angles.tolist(), "torques": torques.tolist(), "periodic": periodic}


TABLES = [drawn(1, 4, False), drawn(2, 23, False), drawn(3, 9, True)]
IDS = ["4 points", "23 points", "periodic"]


class Interpolant:
    """SciPy's, of a table that is written down for as far as it is asked."""

    def __init__(self, table: dict[str, Any]) -> None:
        q, T = np.array(table["angles"]), np.array(table["torques"])
        self.begin, period = q[0], q[-1] - q[0]
        if table["periodic"]:
            periods = np.arange(-6, 7)
            q = np.concatenate([q[:-1] + k * period for k in periods])
            T = np.tile(T[:-1], len(periods))
        else:
            q = np.concatenate([[q[0] - 50.0], q, [q[-1] + 50.0]])
            T = np.concatenate([T[:1], T, T[-1:]])
        self.torque = PchipInterpolator(q, T)

    def potential(self, q: float) -> float:
        return -float(self.torque.integrate(self.begin, q))


def scene_with(folder: Path, table: dict[str, Any], gravity: float = 0.0) -> Scene:
    file = write_scene(
        folder, one_link_urdf(), {"joint": {"torque_table": table}}, gravity=[0.0, 0.0, -gravity],
        energy_flow=True, servo_period=1e-2, integrator={"scheme": "rosenbrock", "dt": 1e-3},
    )  # fmt: skip
    return load_scene(file)


def with_dt(scene: Scene, dt: float) -> Scene:
    return dataclasses.replace(scene, integrator=dataclasses.replace(scene.integrator, dt=dt))


def around(table: dict[str, Any], rng: np.random.Generator, count: int) -> np.ndarray:
    """Angles within and beyond the table, its points and the numbers next to them among them."""
    q = np.array(table["angles"])
    points = np.concatenate([q, np.nextafter(q, np.inf), np.nextafter(q, -np.inf)])
    return np.concatenate([rng.uniform(q[0] - 8.0, q[-1] + 8.0, count), points])


@pytest.mark.parametrize("table", TABLES, ids=IDS)
def test_torque_and_energy_are_those_of_scipys_interpolant(
    tmp_path: Path, table: dict[str, Any]
) -> None:
    """The torque by the speed after 1 us from rest, in which it changes by some 1e-10."""
    truth, dt = Interpolant(table), 1e-6
    plant = Plant(with_dt(scene_with(tmp_path, table), dt))
    for q in around(table, np.random.default_rng(5), 200):
        plant.reset([q])
        assert plant.energy == pytest.approx(truth.potential(q), abs=1e-11), f"energy at {q!r}"
        plant.advance([0.0], 1)
        T = LINK_INERTIA * plant.state.v[0] / dt
        assert pytest.approx(float(truth.torque(q)), abs=1e-8) == T, f"torque at {q!r}"


@pytest.mark.parametrize("table", TABLES, ids=IDS)
def test_a_link_that_a_table_moves_keeps_order_2_and_its_energy(
    tmp_path: Path, table: dict[str, Any]
) -> None:
    truth, scene = Interpolant(table), scene_with(tmp_path, table)
    rng = np.random.default_rng(6)
    errors, gained = np.zeros((6, 3)), np.zeros((6, 3))
    for draw in range(6):
        q0, v0 = float(rng.uniform(-2.0, 2.0)), float(rng.uniform(-2.0, 2.0))
        end = solve_ivp(
            lambda t, x: [x[1], float(truth.torque(x[0])) / LINK_INERTIA],
            (0.0, 0.5), [q0, v0], "DOP853", rtol=1e-11, atol=1e-11, max_step=2e-2,
        ).y[:, -1]  # fmt: skip
        for k, steps in enumerate((20, 40, 80)):
            plant = Plant(with_dt(scene, 1e-2 / steps))
            plant.reset([q0], [v0])
            before = plant.energy
            plant.advance([0.0], 50 * steps)
            errors[draw, k] = abs(plant.state.q[0] - end[0])
            gained[draw, k] = abs(plant.energy - before)
    # Over all draws: one by itself may change its sign between two steps.
    of_errors, of_energy = errors.max(axis=0), gained.max(axis=0)
    assert math.log2(of_errors[1] / of_errors[2]) == pytest.approx(2.0, abs=0.25), f"{errors}"
    assert of_errors[-1] < 1e-4, f"{errors}"
    assert of_energy[-1] < of_energy[0] / 10.0, f"{gained}"


def test_a_table_of_the_weight_balances_it_to_the_error_of_the_cubics(tmp_path: Path) -> None:
    """Let go at rest between two points, the link starts with what the cubic is off by."""
    angles, dt = np.linspace(-math.pi, math.pi, 65), 1e-6
    torques = -WEIGHT * np.cos(angles)
    torques[-1] = torques[0]
    table = {"angles": angles.tolist(), "torques": torques.tolist(), "periodic": True}
    plant, h = Plant(with_dt(scene_with(tmp_path, table, 9.81), dt)), angles[1] - angles[0]
    rng, worst = np.random.default_rng(7), 0.0
    for q in rng.uniform(-10.0, 10.0, 100):
        plant.reset([q])
        plant.advance([0.0], 1)
        worst = max(worst, abs(LINK_INERTIA * plant.state.v[0] / dt))
    # At an extremum the slopes are 0 at its point, or limited beside it: h^2 times the curvature,
    # of which the part within a piece is less than 1/8.
    assert 0.0 < worst < WEIGHT * h**2 / 8.0, f"{worst} N m"


def test_a_torque_that_holds_beyond_the_end_drives_the_link_on_as_a_weight_would(
    tmp_path: Path,
) -> None:
    """From rest, with the energy it stores at 0: its potential falls as far as one likes."""
    table = TABLES[1]
    plant, q0 = Plant(scene_with(tmp_path, table)), 20.0
    plant.reset([q0])
    plant.advance([0.0], 10_000)
    a = table["torques"][-1] / LINK_INERTIA
    assert plant.state.q[0] == pytest.approx(q0 + 0.5 * a * 10.0**2, rel=1e-9)


@pytest.mark.parametrize("table", TABLES[1:], ids=IDS[1:])
def test_links_in_lanes_move_as_single_ones(tmp_path: Path, table: dict[str, Any]) -> None:
    scene, q = scene_with(tmp_path, table), np.linspace(-9.0, 9.0, 9)[:, None]
    moved = Fleet(scene, 9, q=q).run(np.zeros((10, 9, 1)), 20)
    for arm in range(9):
        plant = Plant(scene)
        plant.reset(q[arm])
        alone = plant.run(np.zeros((10, 1)), 20)
        np.testing.assert_allclose(moved[:, arm], alone, rtol=0, atol=1e-11, err_msg=f"arm {arm}")


GOOD: dict[str, Any] = {"angles": [0.0, 1.0, 2.0, 3.0], "torques": [1.0, 2.0, 3.0, 4.0]}
MANY = [0.01 * k for k in range(257)]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"angles": None}, "angles must be a list"),
        ({"angles": [0.0, 1.0, 2.0]}, "angles must have 4 to 256 numbers [rad], got 3"),
        ({"angles": MANY, "torques": MANY}, "angles must have 4 to 256 numbers [rad], got 257"),
        ({"torques": [1.0] * 5}, "torques must have as many numbers as angles, 4, got 5"),
        ({"angles": [0.0, 1.0, 1.0, 2.0]}, "angles must increase by at least 1e-06 rad each, got"),
        ({"angles": [0.0, 2.0, 1.0, 3.0]}, "angles must increase by at least 1e-06 rad each, got"),
        ({"angles": [0.0, 1.0, 2.0, 1e5]}, "angles must have numbers of at most 10000 [rad]"),
        ({"angles": [0.0, 1.0, 2.0, "far"]}, "angles must have numbers of at most 10000 [rad]"),
        ({"torques": [0.0, 1.0, math.nan, 2.0]}, "torques must have numbers of at most 1e+15"),
        ({"torques": [0.0, 1.0, -math.inf, 2.0]}, "torques must have numbers of at most 1e+15"),
        ({"torques": [0.0, 1.0, 10**400, 2.0]}, "torques must have numbers of at most 1e+15"),
        ({"torques": [0.0, True, 1.0, 2.0]}, "torques must have numbers of at most 1e+15"),
        ({"torques": [0.0, [1.0], 1.0, 2.0]}, "torques must have numbers of at most 1e+15"),
        ({"periodic": True}, "torques must end with the torque that they begin with"),
        ({"periodic": 1}, "periodic must be true or false"),
    ],
)
def test_what_is_no_table_is_refused_in_one_line(change: dict[str, Any], said: str) -> None:
    with pytest.raises(Refusal) as refusal:
        load_scene("three_axis", {"joints.elbow.torque_table": GOOD | change})
    line = str(refusal.value)
    assert f"joints.elbow.torque_table.{said}" in line and "\n" not in line, line


@pytest.mark.parametrize("key", ["angles", "torques"])
def test_a_list_that_is_missing_and_a_key_that_is_unknown_are_refused(key: str) -> None:
    table = {other: numbers for other, numbers in GOOD.items() if other != key}
    with pytest.raises(Refusal, match=rf"torque_table\.{key} must have 4 to 256 numbers"):
        load_scene("three_axis", {"joints.elbow.torque_table": table})
    with pytest.raises(Refusal, match=r"key joints\.elbow\.torque_table\.colour"):
        load_scene("three_axis", {"joints.elbow.torque_table": GOOD | {"colour": 1.0}})


def test_tables_at_the_bounds_of_their_numbers_give_finite_coefficients() -> None:
    for angles, torques in (
        ([-1e4, -1e4 + 1e-6, 1e4 - 1e-6, 1e4], [1e15, -1e15, 1e15, -1e15]),
        ([0.0, 1.1e-6, 2.2e-6, 1e4], [0.0, 5e-324, 1e-300, 1e15]),
    ):
        table = {"angles": angles, "torques": torques}
        scene = load_scene("three_axis", {"joints.elbow.torque_table": table})
        (part,) = next(joint for joint in scene.joints if joint.name == "elbow").extras
        text = part.initialiser("elbow", {})
        assert "inf" not in text and "nan" not in text, text
