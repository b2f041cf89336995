"""Cogging, drag and counterbalances, each alone on slides of one tree, against closed forms."""

import math
from pathlib import Path

import numpy as np
import pytest
from draws import with_slow
from machines import ROTOR, write_scene
from scipy.integrate import solve_ivp
from scipy.special import ellipj

from arm_emulator import Plant, Refusal, load_scene
from oracles.random_chain import LINK

MASSES = np.array([6.0, 4.0, 2.0])  # kg, of the slides of each part
RATIO, ORDERS = 0.01, (17.0, 23.0, 31.0)  # of rotors that nothing holds but a tooth
AMPLITUDES = np.random.default_rng(22).uniform(0.01, 0.05, 3)  # N m
DRAG = np.array([0.5, 3.0, 8.0])  # N s2/m2
WEIGHT = -9.0  # m/s2, along the slides with springs alone
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


PERIOD = 0.05  # s
COGGING, DRAGGED, SPRUNG = (slice(k, k + 3) for k in (0, 3, 6))


@pytest.fixture(scope="module")
def slides(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write slides that do not feel each other, three of each part."""
    free = {"kind": "torque", "rotor_inertia": ROTOR}
    parts = [
        *(
            {"motor": free | {"cogging": {"waves": [[k, float(a)]]}}, "gear": {"ratio": RATIO}}
            for k, a in zip(ORDERS, AMPLITUDES, strict=True)
        ),
        *({"drag": {"coefficient": float(c)}} for c in DRAG),
        *({"counterbalance": spring} for spring in SPRINGS.values()),
    ]
    text, joints = '<robot name="slides"><link name="base"/>', {}
    for k, part in enumerate(parts):
        text += LINK.format(
            name=f"j{k}", kind="prismatic", xyz="0 0 0", rpy="0 0 0", parent="base",
            axis="1 0 0" if "counterbalance" in part else "0 1 0", com="0 0 0", com_rpy="0 0 0",
            mass=MASSES[k % 3], ixx=0.1, iyy=0.1, izz=0.1, ixy=0, ixz=0, iyz=0,
        )  # fmt: skip
        joints[f"j{k}"] = part
    return write_scene(
        tmp_path_factory.mktemp("slides"), text + "</robot>", joints, energy_flow=True,
        gravity=[WEIGHT, 0.0, 0.0], servo_period=PERIOD,
        integrator={"scheme": "rosenbrock", "dt": 1e-4},
    )  # fmt: skip


def with_step(slides: Path, dt: float) -> Plant:
    return Plant(load_scene(slides, {"integrator.dt": dt}))


def row(which: slice, values: np.ndarray) -> np.ndarray:
    """Return values of some slides, 0 of all others."""
    out = np.zeros(9)
    out[which] = values
    return out


@pytest.mark.parametrize("m", with_slow([((0.2, 0.7, 0.95),), ((0.95, 0.4, 0.6),)], 1))
def test_a_free_rotor_swings_in_a_tooth_as_a_pendulum(
    slides: Path, m: tuple[float, float, float]
) -> None:
    """J d2tm/dt2 = -a sin(k tm): sin(k tm / 2) = m sn(W t, m^2), W^2 = k a / J, to order 2."""
    k, modulus, errors = np.array(ORDERS), np.array(m), []
    W = np.sqrt(k * AMPLITUDES / (ROTOR + MASSES * RATIO**2))
    for dt in (1e-4, 5e-5):
        plant, off = with_step(slides, dt), []
        plant.reset(np.zeros(9), row(COGGING, RATIO * 2.0 * modulus * W / k))
        for _ in range(30):
            plant.advance(np.zeros(9), round(0.01 / dt))
            sn = ellipj(W * plant.t, modulus**2)[0]
            truth = 2.0 / k * np.arcsin(modulus * sn)
            off.append(np.abs(plant.state.theta_m[COGGING] - truth) * k)
        errors.append(float(np.max(off)))
    # Of the phase k tm; a quarter at half the step, but for the error's next term.
    assert errors[1] < 2e-3 and errors[1] < 0.3 * errors[0], f"{errors}"


def test_a_link_with_drag_coasts_as_the_closed_form_with_order_2(slides: Path) -> None:
    """In either direction, and drag takes the energy that the links lose."""
    V, seconds = np.array([2.0, -1.5, 3.0]), 1.0
    truth = MASSES / DRAG * np.sign(V) * np.log1p(DRAG * np.abs(V) * seconds / MASSES)
    errors, left = [], []
    for steps in (4, 8, 16, 32):
        plant, taken = with_step(slides, PERIOD / steps), np.zeros(3)
        plant.reset(np.zeros(9), row(DRAGGED, V))
        for _ in range(round(seconds / PERIOD)):
            taken += plant.advance_metered(np.zeros(9), steps).dissipated[DRAGGED]
        errors.append(np.abs(plant.state.q[DRAGGED] - truth).max())
        lost = 0.5 * MASSES * (V**2 - plant.state.v[DRAGGED] ** 2)
        left.append(np.abs(taken / lost - 1.0).max())
    order = np.log2(np.array(errors[:-1]) / errors[1:])
    assert (order > 1.8).all() and errors[-1] < errors[0] / 50.0, (errors, order)
    assert left[-1] < left[0] / 30.0, "the rest of energy falls with the square of the step"


def test_links_swing_in_their_springs_with_order_2_and_keep_their_energy(slides: Path) -> None:
    rng = np.random.default_rng(1)
    for _ in range(4):
        q0, v0 = rng.uniform(-2.0, 2.0, (2, 3))
        truth = [
            solve_ivp(
                lambda t, x, spring=spring, M=M: [x[1], torque(x[0], spring) / M + WEIGHT],
                (0.0, 1.0), [q, v], "DOP853", rtol=1e-12, atol=1e-12,
            ).y[0, -1]
            for spring, M, q, v in zip(SPRINGS.values(), MASSES, q0, v0, strict=True)
        ]  # fmt: skip
        errors, gained = [], []
        for steps in (10, 20, 40):
            plant = with_step(slides, 1e-2 / steps)
            plant.reset(row(SPRUNG, q0), row(SPRUNG, v0))
            before = plant.energy
            plant.advance(np.zeros(9), 100 * steps)
            errors.append(np.abs(plant.state.q[SPRUNG] - truth))
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


# Cases of any waves are in test_kinematic_error.py.
BAD: list[tuple[object, str]] = [
    ([[1.0]], "must list waves of [order, amplitude in N m]"),
    ([[6.0, 1001.0]], "must list waves whose amplitude is a number within +-1000 N m"),
]


@pytest.mark.parametrize(("waves", "words"), BAD, ids=lambda value: str(value)[:30])
def test_bad_waves_are_refused_in_a_line(waves: object, words: str) -> None:
    with pytest.raises(Refusal) as refusal:
        load_scene("three_axis", {"joints.elbow.motor.cogging": {"waves": waves}})
    printed = str(refusal.value)
    assert (
        printed.startswith("three_axis.yaml: joints.elbow.motor.cogging.waves ")
        and words in printed
    )
    assert "\n" not in printed
