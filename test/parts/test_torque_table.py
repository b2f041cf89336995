"""Torques over the angle as tables: SciPy's interpolant, its energy, the order of the motion."""

import dataclasses
import math
from typing import Any

import numpy as np
import pytest
from machines import GANTRY, MOVED, gantry_urdf, write_scene
from scipy.integrate import solve_ivp
from scipy.interpolate import PchipInterpolator

from arm_emulator import Plant, Refusal, Scene, load_scene


def draw_table(seed: int, points: int, periodic: bool) -> dict[str, Any]:
    rng = np.random.default_rng(seed)
    angles = -2.5 + np.cumsum(rng.uniform(0.02, 1.0, points))
    torques = rng.uniform(-5.0, 5.0, points)
    torques[2] = torques[1]  # a piece that is level
    if periodic:
        torques[-1] = torques[0]
    else:
        torques[-1] = abs(torques[-1])  # which drives the link on beyond the end
    return {"angles": angles.tolist(), "torques": torques.tolist(), "periodic": periodic}


TABLES = [draw_table(1, 4, False), draw_table(2, 23, False), draw_table(3, 9, True)]


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


@pytest.fixture(scope="module")
def gantry(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    """Links that do not feel each other, each moved by one of the tables."""
    joints = {name: {"torque_table": table} for name, table in zip(GANTRY, TABLES, strict=True)}
    file = write_scene(
        tmp_path_factory.mktemp("gantry"), gantry_urdf(), joints, energy_flow=True,
        servo_period=1e-2, integrator={"scheme": "rosenbrock", "dt": 1e-3},
    )  # fmt: skip
    return load_scene(file)


def with_dt(scene: Scene, dt: float) -> Scene:
    return dataclasses.replace(scene, integrator=dataclasses.replace(scene.integrator, dt=dt))


def around(table: dict[str, Any], rng: np.random.Generator, count: int) -> np.ndarray:
    """Angles within and beyond the table, its points and the numbers next to them among them."""
    q = np.array(table["angles"])
    points = np.concatenate([q, np.nextafter(q, np.inf), np.nextafter(q, -np.inf)])
    return np.concatenate([rng.uniform(q[0] - 8.0, q[-1] + 8.0, count), points])


def test_torque_and_energy_are_those_of_scipys_interpolant(gantry: Scene) -> None:
    """The torque by the speed after 1 us from rest, in which it changes by some 1e-10."""
    truths, dt = [Interpolant(table) for table in TABLES], 1e-6
    rng = np.random.default_rng(5)
    samples = [around(table, rng, 200) for table in TABLES]
    count = max(map(len, samples))
    angles = np.column_stack([np.resize(sample, count) for sample in samples])
    plant = Plant(with_dt(gantry, dt))
    for q in angles:
        plant.reset(q)
        stored = sum(truth.potential(position) for truth, position in zip(truths, q, strict=True))
        assert plant.energy == pytest.approx(stored, abs=1e-11), f"energy at {q!r}"
        plant.advance(np.zeros(3), 1)
        T = [float(truth.torque(position)) for truth, position in zip(truths, q, strict=True)]
        assert MOVED * plant.state.v / dt == pytest.approx(T, abs=1e-8), f"torques at {q!r}"


def test_a_link_that_a_table_moves_keeps_order_2_and_its_energy(gantry: Scene) -> None:
    rng, draws = np.random.default_rng(6), 6
    errors, gained = np.zeros((draws, 3, 3)), np.zeros((draws, 3))
    for draw in range(draws):
        q0, v0 = rng.uniform(-2.0, 2.0, (2, 3))
        end = [
            solve_ivp(
                lambda t, x, table=table, M=M: [x[1], float(table.torque(x[0])) / M],
                (0.0, 1.0), [q, v], "DOP853", rtol=1e-11, atol=1e-11, max_step=2e-2,
            ).y[0, -1]
            for table, M, q, v in zip(map(Interpolant, TABLES), MOVED, q0, v0, strict=True)
        ]  # fmt: skip
        for k, steps in enumerate((5, 10, 20)):
            plant = Plant(with_dt(gantry, 1e-2 / steps))
            plant.reset(q0, v0)
            before = plant.energy
            plant.advance(np.zeros(3), 100 * steps)
            errors[draw, k] = np.abs(plant.state.q - end)
            gained[draw, k] = abs(plant.energy - before)
    # Over all draws: one by itself may change its sign between two steps.
    of_errors, of_energy = errors.max(axis=0), gained.max(axis=0)
    orders = np.log2(of_errors[1] / of_errors[2])
    assert orders == pytest.approx(2.0, abs=0.25), f"tables {of_errors}"
    assert of_errors[-1].max() < 1e-4, f"tables {of_errors}"
    assert of_energy[-1] < of_energy[0] / 10.0, f"{gained}"


GOOD: dict[str, Any] = {"angles": [0.0, 1.0, 2.0, 3.0], "torques": [1.0, 2.0, 3.0, 4.0]}
MANY = [0.01 * k for k in range(257)]


NO_TORQUES = "torques must have 4 to 256 numbers within +-1e+15 N m"


@pytest.mark.parametrize(
    ("change", "printed"),
    [
        ({"angles": None}, "angles must be a list"),
        ({"angles": [0.0, 1.0, 2.0]}, "4 to 256 numbers within +-10000 rad, got 3"),
        ({"angles": MANY, "torques": MANY}, "numbers within +-10000 rad, got 257"),
        ({"angles": [0.0, 1.0, 2.0, 1e5]}, "angles must have 4 to 256 numbers within +-10000 rad"),
        ({"torques": [1.0] * 5}, "torques must have as many numbers as angles, 4, got 5"),
        *(({"torques": [0.0, x, 1.0, 2.0]}, NO_TORQUES)
          for x in ("far", math.nan, -math.inf, 10**400, True, [1.0])),
        *(({"angles": [0.0, 2.0, x, 3.0]}, "angles must increase by at least 1e-06 rad each, got")
          for x in (1.0, 2.0)),
        ({"periodic": True}, "torques must end with the torque that they begin with"),
        ({"periodic": 1}, "periodic must be true or false"),
    ],
    ids=range(15),
)  # fmt: skip
def test_a_file_that_is_no_table_is_refused_in_a_line(change: dict[str, Any], printed: str) -> None:
    with pytest.raises(Refusal) as refusal:
        load_scene("three_axis", {"joints.elbow.torque_table": GOOD | change})
    line = str(refusal.value)
    assert "joints.elbow.torque_table." in line and printed in line and "\n" not in line, line


@pytest.mark.parametrize("key", ["angles", "torques"])
def test_a_list_that_is_missing_and_a_key_that_is_unknown_are_refused(key: str) -> None:
    table = {name: numbers for name, numbers in GOOD.items() if name != key}
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
        text = part.write_initialiser("elbow", {})
        assert "inf" not in text and "nan" not in text, text
