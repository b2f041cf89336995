"""Gears whose teeth are not quite where they should be."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from draws import some
from machines import LINK_INERTIA, make_link_urdf, write_scene
from scipy.integrate import solve_ivp

from arm_emulator import Plant, Refusal, load_scene
from arm_emulator.base.arrays import Array
from arm_emulator.machine.schemes.known import KNOWN, SCHEMES

PERIOD = 1e-2  # s, over which a voltage is held
VISCOUS = 0.2


def sample_waves(rng: np.random.Generator, ratio: float) -> dict[str, Any]:
    """Waves of up to a third of the steepness that there may be."""
    waves: dict[str, list[list[float]]] = {"motor": [], "link": []}
    for shaft, largest, orders in (("motor", abs(ratio), [1, 2, 4]), ("link", 1.0, [1, 3, 8.5])):
        for order in rng.choice(orders, int(rng.integers(1, 3)), replace=False):
            amplitude = largest / float(order) * float(rng.uniform(0.05, 0.15))
            waves[shaft].append([float(order), amplitude, float(rng.uniform(0.0, 6.0))])
    return waves


def machine(rng: np.random.Generator) -> dict[str, Any]:
    ratio = float(rng.choice([-1.0, 1.0]) * rng.uniform(0.02, 0.05))
    gear = {
        "ratio": ratio,
        "stiffness": float(10 ** rng.uniform(2.5, 3.5)),
        "damping": float(rng.uniform(0.5, 3.0)),
        "kinematic_error": sample_waves(rng, ratio),
    }
    motor = {"resistance": 1.0, "torque_constant": 0.05, "back_emf_constant": 0.05,
             "rotor_inertia": float(10 ** rng.uniform(-4.0, -3.3))}  # fmt: skip
    return {"motor": motor, "gear": gear, "friction": {"viscous": VISCOUS}}


def error_of(waves: list[list[float]], angle: float) -> tuple[float, float]:
    k, a, phi = np.array(waves).T
    return float(a @ np.sin(k * angle + phi)), float(k * a @ np.cos(k * angle + phi))


def truth(joint: dict[str, Any], voltages: Array) -> Array:
    """tm, wm, q, v after each row, from the equations by virtual work."""
    motor, gear = joint["motor"], joint["gear"]
    Ng, Kg, Dg = gear["ratio"], gear["stiffness"], gear["damping"]
    waves = gear["kinematic_error"]

    def rates(_: float, x: Array, V: float) -> list[float]:
        tm, wm, q, v = x
        e_m, slope_m = error_of(waves["motor"], tm)
        e_l, slope_l = error_of(waves["link"], q)
        F = Kg * (Ng * tm - q + e_m + e_l) + Dg * ((Ng + slope_m) * wm - (1.0 - slope_l) * v)
        i = (V - motor["back_emf_constant"] * wm) / motor["resistance"]
        torque = motor["torque_constant"] * i - (Ng + slope_m) * F
        return [wm, torque / motor["rotor_inertia"], v,
                ((1.0 - slope_l) * F - VISCOUS * v) / LINK_INERTIA]  # fmt: skip

    tm = 0.0
    for _ in range(50):  # begins unloaded
        e, slope = error_of(waves["motor"], tm)
        tm -= (Ng * tm + e + error_of(waves["link"], 0.0)[0]) / (Ng + slope)
    x, out = np.array([tm, 0.0, 0.0, 0.0]), []
    for (V,) in voltages:
        x = solve_ivp(rates, (0.0, PERIOD), x, "DOP853", rtol=1e-12, atol=1e-14, args=(V,)).y[:, -1]
        out.append(x)
    return np.array(out)


@pytest.fixture(scope="module")
def sample_machine(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    joint = machine(np.random.default_rng(51))
    file = write_scene(
        tmp_path_factory.mktemp("gear"), make_link_urdf(), {"joint": joint}, servo_period=PERIOD,
        energy_flow=True,
    )  # fmt: skip
    return file, joint


def with_steps(file: Path, steps: int, scheme: str = "rosenbrock") -> Plant:
    return Plant(load_scene(file, {"integrator": {"scheme": scheme, "dt": PERIOD / steps}}))


@pytest.mark.parametrize("scheme", some(["rosenbrock", "paper", "extrapolated", "implicit"], 1))
def test_every_scheme_keeps_its_order(
    sample_machine: tuple[Path, dict[str, Any]], scheme: str
) -> None:
    file, joint = sample_machine
    voltages = np.random.default_rng(SCHEMES.index(scheme)).uniform(-15.0, 15.0, (12, 1))
    expected = truth(joint, voltages)
    errors = []
    for steps in (80, 160, 320, 640):
        plant = with_steps(file, steps, scheme)
        assert plant.state.gear_torque[0] == pytest.approx(0.0, abs=1e-9), "it begins unloaded"
        q = plant.run(voltages, steps)
        errors.append(float(np.abs(q[:, 0] - expected[:, 2]).max()))
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    # The next term of the error's expansion may be some per cent of it.
    slack = 0.15 if KNOWN[scheme].order == 2 else 0.3
    assert orders[-1] == pytest.approx(KNOWN[scheme].order, abs=slack), errors
    if KNOWN[scheme].order == 1:
        return
    x = plant.state
    end = np.array([x.theta_m[0], x.omega_m[0], x.q[0], x.v[0]])
    assert end == pytest.approx(expected[-1], rel=0.02, abs=1e-3), "motor and link at the end"


def test_a_slow_link_is_off_by_the_error(sample_machine: tuple[Path, dict[str, Any]]) -> None:
    """Without load the link is where ratio and error state, at any angle of the motor."""
    file, joint = sample_machine
    plant = with_steps(file, 80)
    waves, Ng = joint["gear"]["kinematic_error"], joint["gear"]["ratio"]
    for q in np.random.default_rng(53).uniform(-3.0, 3.0, 20):
        plant.reset(q=[q])
        tm = float(plant.state.theta_m[0])
        e = error_of(waves["motor"], tm)[0] + error_of(waves["link"], q)[0]
        assert Ng * tm + e == pytest.approx(q, abs=1e-12), "the motor behind a link at rest"
        assert plant.energy == pytest.approx(0.0, abs=1e-15), "nothing is wound up"


@pytest.mark.parametrize(
    ("waves", "words"),
    [
        ({"motor": 3}, "motor must be a list"),
        ({"motor": [[1]]}, "motor must list waves of"),
        ({"motor": ["one"]}, "motor must list waves of"),
        ({"motor": [[1, True]]}, "motor must list waves whose amplitude is a number"),
        ({"motor": [[1, float("nan")]]}, "motor must list waves whose amplitude is a number"),
        ({"link": [[0, 1e-4]]}, "link must list waves whose order is a number > 0"),
        ({"link": [[-1, 1e-4]]}, "link must list waves whose order is a number > 0"),
        ({"link": [[1, 10**400]]}, "link must list waves whose amplitude is a number"),
        ({"motor": [[100, 1e-3]]}, "motor must have order times amplitude sum up to at most 0.009"),
        ({"link": [[1, 0.5], [2, 0.3]]}, "link must have order times amplitude sum up to"),
        ({"link": [[1, 1e-4]] * 17}, "link must have at most 16 waves"),
        ({"rotor": []}, "key joints.elbow.gear.kinematic_error.rotor must be known"),
        (3, "kinematic_error must be a section"),
    ],
)  # fmt: skip
def test_waves_that_make_no_sense_are_refused_in_a_line(waves: object, words: str) -> None:
    with pytest.raises(Refusal) as refusal:
        load_scene("three_axis", {"joints.elbow.gear.kinematic_error": waves})
    assert words in str(refusal.value) and "\n" not in str(refusal.value), refusal.value
