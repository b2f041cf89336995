"""Gears with play: rotor and link fly freely, touch and bounce as the closed form states."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from balance import balance_of
from draws import some, with_slow
from machines import LINK_INERTIA, make_link_urdf, write_scene
from test_located import STICKING

from arm_emulator import Plant, Scene, load_scene
from arm_emulator.base.arrays import Array

ROWS = 60


def sample_joint(rng: np.random.Generator) -> tuple[dict[str, Any], float]:
    """A joint that nothing drives, and the speed of its rotor, seen at the link."""
    ratio = float(rng.uniform(0.01, 0.05))
    reflected = LINK_INERTIA * float(10 ** rng.uniform(-0.7, 0.7))
    stiffness = float(10 ** rng.uniform(3.0, 4.0))
    mu = reflected * LINK_INERTIA / (reflected + LINK_INERTIA)
    damping = float(rng.choice([0.0, rng.uniform(0.05, 0.6)])) * 2.0 * np.sqrt(stiffness * mu)
    gear = {"ratio": ratio, "stiffness": stiffness, "damping": float(damping), "backlash": 0.02}
    motor = {"resistance": 1.0, "torque_constant": 0.05, "back_emf_constant": 0.0}
    motor["rotor_inertia"] = reflected * ratio**2
    return {"motor": motor, "gear": gear}, float(rng.uniform(0.3, 1.0))


def truth(joint: dict[str, Any], speed: float, t: Array) -> tuple[Array, int, Array]:
    """Position of the link, how often a tooth touched, and the gear's twist w and dw/dt at the end.

    The twist flies freely within the play. From where a tooth touches it is a damped oscillation,
    until the tooth would have to pull.
    """
    motor, gear = joint["motor"], joint["gear"]
    K, D, gap = gear["stiffness"], gear["damping"], gear["backlash"] / 2.0
    reflected = motor["rotor_inertia"] / gear["ratio"] ** 2
    both = reflected + LINK_INERTIA
    mu = reflected * LINK_INERTIA / both
    a = D / (2.0 * mu)
    wd = np.sqrt(K / mu - a * a)
    contact = np.arctan2(2.0 * a * wd, a * a - wd * wd)
    contact /= wd
    w = np.full_like(t, np.nan)
    start, at, rate, touched = 0.0, 0.0, speed, 0
    while start < t[-1]:
        side = np.sign(rate)
        flight = (side * gap - at) / rate
        here = (t >= start) & (t < start + flight)
        w[here] = at + rate * (t[here] - start)
        start += flight
        here = (t >= start) & (t < start + contact)
        s = t[here] - start
        w[here] = side * gap + rate / wd * np.exp(-a * s) * np.sin(wd * s)
        touched += 1
        decay, s = np.exp(-a * contact), wd * contact
        at = side * gap + rate / wd * decay * np.sin(s)
        rate *= decay * (np.cos(s) - a / wd * np.sin(s))
        start += contact
    together = reflected / both * speed * t
    return together - reflected / both * w, touched, w


def scene_of(folder: Path, period: float, steps: int, **integrator: Any) -> Scene:
    joint, _ = sample_joint(np.random.default_rng(0))
    file = write_scene(
        folder,
        make_link_urdf(),
        {"joint": joint},
        servo_period=period,
        integrator={"scheme": "rosenbrock", "dt": period / steps, **integrator},
        energy_flow=True,
        varied=["joints.*.motor.rotor_inertia", "joints.*.gear.*"],
    )
    return load_scene(file)


def begin(plant: Plant, joint: dict[str, Any], speed: float) -> None:
    """Make the machine the drawn one, its rotor moving. (The ratio is no number but structure.)"""
    for key in ("stiffness", "damping", "backlash"):
        plant.set_parameter(f"joints.joint.gear.{key}", joint["gear"][key])
    ratio = plant.scene.joints[0].gear.ratio
    inertia = joint["motor"]["rotor_inertia"] * (ratio / joint["gear"]["ratio"]) ** 2
    plant.set_parameter("joints.joint.motor.rotor_inertia", inertia)
    plant.put("test", {"theta_m": [0.0], "omega_m": [speed / ratio]})


def span(joint: dict[str, Any], speed: float) -> float:
    """A servo period of which ROWS have some bounces."""
    return float(round(3.0 * joint["gear"]["backlash"] / speed / ROWS * 3.0, 9))


@pytest.mark.parametrize("scheme", some(["rosenbrock", "extrapolated"], 1))
@pytest.mark.parametrize("seed", with_slow(range(4), 1))
def test_teeth_bounce_as_the_closed_form_states_with_order_two(
    tmp_path: Path, seed: int, scheme: str
) -> None:
    joint, speed = sample_joint(np.random.default_rng([seed, 21]))
    period = span(joint, speed)
    q, touched, _ = truth(joint, speed, period * np.arange(1, ROWS + 1))
    assert touched >= 2, "both teeth shall touch"
    errors, left = [], []
    for steps in (8, 16, 32):
        plant = Plant(scene_of(tmp_path, period, steps, scheme=scheme, events="located"))
        begin(plant, joint, speed)
        stored, out, lost = plant.energy, [], 0.0
        for _ in range(ROWS):
            lost += plant.advance_metered(np.zeros(1), steps).dissipated.sum()
            out.append(float(plant.state.q[0]))
        errors.append(float(np.abs(np.array(out) - q).max()))
        left.append(abs(plant.energy - stored + lost) / stored)
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    # The next term of the error's expansion is a few per cent of it with 60 steps a contact.
    assert orders[-1] == pytest.approx(2.0, abs=0.35), errors
    assert left[-1] < 1e-2, f"energy {left}"
    assert left[-1] < 0.4 * left[-2] or left[-1] < 1e-5, f"the balance closes as the scheme, {left}"


@pytest.mark.slow
@pytest.mark.parametrize("scheme", some(["rosenbrock", "implicit", "extrapolated", "paper"], 1))
def test_steps_that_are_not_cut_come_to_the_same_bounces(tmp_path: Path, scheme: str) -> None:
    joint, speed = sample_joint(np.random.default_rng([3, 21]))
    period = span(joint, speed)
    q, _, _ = truth(joint, speed, period * np.arange(1, ROWS + 1))
    errors = []
    for steps in (20, 200):
        plant = Plant(scene_of(tmp_path, period, steps, scheme=scheme))
        begin(plant, joint, speed)
        errors.append(float(np.abs(plant.run(np.zeros((ROWS, 1)), steps)[:, 0] - q).max()))
    assert errors[1] < 0.02 * np.ptp(q), errors
    assert errors[1] < 0.4 * errors[0], f"a tenth of the step, {errors}"


@pytest.mark.slow
def test_a_gear_without_play_is_elastic() -> None:
    """Its damper pulls, too, and it cuts no step; links that stick keep their located events."""
    rows = np.random.default_rng(0).uniform(-12.0, 12.0, (40, 3))
    worn = {"joints.*.gear.backlash": 0.0, "faults": ["*.backlash_grows"]}
    common = STICKING | {"integrator.dt": 1e-4}
    plants = [Plant(load_scene("three_axis", common | more)) for more in ({}, worn)]
    elastic, without_play = (balance_of(plant, rows, 100) for plant in plants)
    # Instants of events are known to 1e-10 of a step, and sticking amplifies rounding little.
    assert plants[1].state.q == pytest.approx(plants[0].state.q, abs=1e-9)
    assert plants[1].state.theta_m == pytest.approx(plants[0].state.theta_m, abs=1e-7)
    assert without_play.dissipated == pytest.approx(elastic.dissipated, rel=1e-7)
