"""Gears that stiffen as they wind up: a part of the drive that is not linear."""

import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from draws import some
from machines import list_moving_joints, make_link_urdf, write_random_chain, write_scene

from arm_emulator import Diverged, Plant, Scene, load_scene
from arm_emulator.base.arrays import Array
from arm_emulator.core import CORE
from arm_emulator.machine.parts.gears.gear import RigidGear
from arm_emulator.machine.parts.gears.progressive_gear import ProgressiveGear
from arm_emulator.machine.plant.compiler import FLAGS
from arm_emulator.machine.plant.scene_unit import write_scene_unit
from arm_emulator.machine.schemes.known import KNOWN, SCHEMES
from arm_emulator.toolchain.compiler_command import find_compiler
from oracles.reference import solve_positions, solve_states

PERIOD = 1e-2  # s, over which a voltage is held
# A scheme of second order and one of first first.
SCHEME_ORDERS = [
    (scheme, KNOWN[scheme].order) for scheme in ("rosenbrock", "implicit", "extrapolated", "paper")
]


def draw_gear(rng: np.random.Generator, torque: float) -> dict[str, float]:
    """A gear in which the cube has a tenth to three times the linear share at that torque."""
    Kg = float(10 ** rng.uniform(3.0, 4.0))
    share = float(10 ** rng.uniform(-1.0, 0.5))
    return {
        "ratio": float(rng.uniform(0.01, 0.03)),
        "stiffness": Kg,
        "cubic_stiffness": share * Kg * (Kg / torque) ** 2,
        "damping": float(rng.choice([0.0, rng.uniform(0.5, 5.0)])),
    }


def draw_motor(rng: np.random.Generator, inductance: bool) -> dict[str, float]:
    motor = {
        "resistance": float(rng.uniform(0.5, 2.0)),
        "torque_constant": 0.05,
        "back_emf_constant": float(rng.uniform(0.04, 0.05)),
        "rotor_inertia": float(10 ** rng.uniform(-4.3, -3.5)),
    }
    return motor | ({"inductance": 2e-3} if inductance else {})


def draw_arm(folder: Path, seed: int) -> Path:
    """Three random joints, at least one with such a gear; others linear, rigid or without motor."""
    rng = np.random.default_rng([seed, 77])
    urdf = write_random_chain(rng, 3)
    joints: dict[str, dict[str, Any]] = {}
    kinds = rng.permutation(
        ["progressive", *rng.choice(["progressive", "linear", "rigid", "no"], 2)]
    )
    for place, (name, kind) in enumerate(zip(list_moving_joints(urdf), kinds, strict=True)):
        joints[name] = {"friction": {"viscous": float(rng.uniform(0.0, 1.0))}}
        if kind == "no":
            continue
        gear = draw_gear(rng, torque=20.0)
        if kind != "progressive":
            del gear["cubic_stiffness"]
        if kind == "rigid":
            gear = {"ratio": gear["ratio"]}
        joints[name] |= {"motor": draw_motor(rng, (seed + place) % 2 == 0), "gear": gear}
    return write_scene(
        folder, urdf, joints, gravity=[0.0, 0.0, -9.81], servo_period=PERIOD, energy_flow=True
    )


def write_gear(folder: Path, scheme: str, dt: float, period: float = PERIOD) -> Path:
    """One link behind such a gear, in gravity, all of whose numbers may be set."""
    rng = np.random.default_rng(1)
    joint = {
        "motor": draw_motor(rng, inductance=True),
        "gear": draw_gear(rng, torque=10.0) | {"ratio": 0.02},
    }
    return write_scene(
        folder, make_link_urdf(), {"joint": joint}, servo_period=period,
        varied=["joints.*", "links.*"], gravity=[0.0, 0.0, -9.81],
        integrator={"scheme": scheme, "dt": dt},
    )  # fmt: skip


def plant_with(file: Path, **sections: dict[str, float]) -> Plant:
    """The machine of `file` with other numbers; a ratio is no number but structure."""
    plant = Plant(load_scene(file))
    for section, numbers in sections.items():
        for key, value in numbers.items():
            if key != "ratio":
                plant.set_parameter(f"joints.joint.{section}.{key}", value)
    plant.reset()
    return plant


def with_steps(file: Path, scheme: str, steps: int) -> Scene:
    return load_scene(file, {"integrator": {"scheme": scheme, "dt": PERIOD / steps}})


def orders_of(errors: list[float]) -> Array:
    return np.log2(np.array(errors[:-1]) / errors[1:])


@pytest.mark.parametrize("seed", some(range(2), 1))
def test_every_scheme_keeps_its_order_on_random_arms(tmp_path: Path, seed: int) -> None:
    file = draw_arm(tmp_path, seed)
    voltages = np.random.default_rng(seed).uniform(-20.0, 20.0, (4, 3))
    truth = solve_states(load_scene(file), voltages, PERIOD, 1e-12, method="DOP853")
    for scheme, order in some(SCHEME_ORDERS, 1):
        errors = []
        for steps in (40, 80, 160, 320):
            plant = Plant(with_steps(file, scheme, steps))
            errors.append(float(np.abs(plant.run(voltages, steps) - truth[:, 3]).max()))
        # The next term of the error's expansion may be 10 % of it, and a bit more with order 1.
        slack = 0.15 if order == 2 else 0.3
        assert orders_of(errors)[-2:] == pytest.approx(order, abs=slack), (scheme, errors)
        x = plant.state
        end = np.array([x.theta_m, x.omega_m, x.v]) - truth[-1, [1, 2, 4]]
        moving = np.array([j.motor is not None and j.gear.stiffness is not None
                           for j in plant.scene.joints])  # fmt: skip
        size = np.abs(truth[:, 2:]).max() * (1e-3 if order == 2 else 0.05)
        assert np.abs(end[:2, moving]).max(initial=0.0) < size, "motors beside the truth"
        assert np.abs(end[2]).max() < size, "speeds beside the truth"


@pytest.mark.slow
def test_the_gear_winds_up_by_its_torque(tmp_path: Path) -> None:
    """At rest under gravity: torque, wind-up and Kg w + Kg3 w^3 agree."""
    rng = np.random.default_rng(8)
    file = write_gear(tmp_path, "rosenbrock", 1e-4)
    for _ in range(3):
        gear = draw_gear(rng, torque=6.0) | {"damping": 5.0, "ratio": 0.02}
        motor = draw_motor(rng, inductance=True)
        plant = plant_with(file, motor=motor, gear=gear, friction={"viscous": 2.0})
        unwound, A = plant.energy, ProgressiveGear(**gear).compute_wind_up(6.0)
        plant.put("the gear", {"theta_m": [A / gear["ratio"]]})
        stored = 0.5 * gear["stiffness"] * A**2 + 0.25 * gear["cubic_stiffness"] * A**4
        assert plant.energy - unwound == pytest.approx(stored, rel=1e-9), "of the wound gear"
        plant.reset()
        # Held by a voltage that is less than the weight's: the link hangs aslant.
        hold = 0.6 * 2.0 * 0.3 * 9.81 * gear["ratio"] / motor["torque_constant"]
        plant.advance([hold * motor["resistance"]], 1_000_000)
        x = plant.state
        assert abs(x.v[0]) < 1e-9 and abs(x.q[0]) > 0.1, "at rest, aslant"
        w = gear["ratio"] * x.theta_m[0] - x.q[0]
        T = gear["stiffness"] * w + gear["cubic_stiffness"] * w**3
        assert x.gear_torque[0] == pytest.approx(T, rel=1e-9), "the torque that is reported"
        weight = -2.0 * 0.3 * 9.81 * np.cos(x.q[0])  # q turns the link down
        assert x.gear_torque[0] == pytest.approx(weight, rel=1e-6), "the torque of the weight"
        assert ProgressiveGear(**gear).compute_wind_up(T) == pytest.approx(w, rel=1e-9), "wind_up"


def test_wind_up_solves_the_cubic() -> None:
    rng = np.random.default_rng(2)
    for _ in range(200):
        Kg, Kg3, T = 10 ** rng.uniform((-2.0, -15.0, -6.0), (8.0, 15.0, 6.0))
        T *= rng.choice([-1.0, 1.0])
        w = ProgressiveGear(ratio=1.0, stiffness=Kg, cubic_stiffness=Kg3).compute_wind_up(T)
        assert Kg * w + Kg3 * w**3 == pytest.approx(T, rel=1e-9), (Kg, Kg3, T)
    assert (
        ProgressiveGear(ratio=1.0, stiffness=100.0, cubic_stiffness=0.0).compute_wind_up(5.0)
        == 0.05
    ), "no cube"
    assert RigidGear(ratio=1.0).compute_wind_up(5.0) == 0.0, "rigid"


@pytest.mark.slow
@pytest.mark.parametrize("scheme", some(SCHEMES, 1))
def test_without_a_cube_the_gear_is_the_linear_gear(tmp_path: Path, scheme: str) -> None:
    """A part that is absent is not compiled; one of no effect changes rounding alone."""
    rng = np.random.default_rng([SCHEMES.index(scheme), 4])
    file = write_gear(tmp_path, scheme, PERIOD / 100)
    linear = load_scene(file, {"joints.joint.gear.cubic_stiffness": None})
    scenes = [linear, load_scene(file)]
    named = ["ProgressiveGear" in write_scene_unit(scene) for scene in scenes]
    assert named == [False, True], "which gear the core is compiled with"
    voltages = rng.uniform(-20.0, 20.0, (10, 1))
    linear_motion = Plant(linear).run(voltages, 100)
    cubic_motion = plant_with(file, gear={"cubic_stiffness": 0.0}).run(voltages, 100)
    np.testing.assert_allclose(
        linear_motion, cubic_motion, rtol=1e-9, atol=1e-12, err_msg="the motions"
    )


@pytest.mark.parametrize("scheme", some(["rosenbrock", "implicit"], 1))
def test_a_gear_too_stiff_for_the_step_is_followed_or_diverges(tmp_path: Path, scheme: str) -> None:
    """A motion that a scheme does not damp is never wrong without a report."""
    rng = np.random.default_rng([SCHEMES.index(scheme), 3])
    name, rows, outcomes = "joints.joint.gear.cubic_stiffness", 15, []
    file = write_gear(tmp_path, scheme, 1e-3)
    own = {"motor": draw_motor(rng, inductance=True),
           "gear": draw_gear(rng, torque=20.0) | {"damping": 1.0},
           "friction": {"viscous": 0.1}}  # fmt: skip
    numbers = {
        f"joints.joint.{section}.{key}": value
        for section, keys in own.items()
        for key, value in keys.items()
        if key != "ratio"
    }
    for Kg3 in 10.0 ** rng.permutation(some([8.0, 10.0, 12.0, 14.0, 9.0, 11.0, 13.0, 15.0], 4)):
        voltages = rng.uniform(-20.0, 20.0, (rows, 1))
        plant = Plant(load_scene(file, numbers | {name: float(Kg3)}))
        try:
            q = plant.run(voltages, 10)
        except Diverged:
            outcomes.append("diverged")
            continue
        truth = solve_positions(plant.scene, voltages, PERIOD, 1e-8)
        off = float(np.abs(q - truth).max() / np.abs(truth).max())
        assert off < 0.1, f"Kg3 = {Kg3:g}: a wrong motion in silence, off by {off:.0%}"
        outcomes.append("followed")
    assert set(outcomes) == {"diverged", "followed"}, outcomes


@pytest.mark.slow
def test_a_gear_that_is_wrongly_declared_linear_does_not_compile(tmp_path: Path) -> None:
    """A part that fails to declare its nonlinearity does not compile."""
    core = shutil.copytree(CORE, tmp_path / "core")
    gear = core / "parts/gears/gear.hpp"
    text = gear.read_text()
    torque = "return Kg * (Ng * tm - q) + Dg * (Ng * wm - v);"
    assert text.count(torque) == 1, "the line of the linear gear's torque"
    unit = tmp_path / "unit.cpp"
    unit.write_text(write_scene_unit(load_scene("three_axis")))
    outcomes = {}
    for more in ("", " + 1e3 * (tm - q) * (tm - q)"):
        gear.write_text(text.replace(torque, torque[:-1] + more + ";"))
        command = [*find_compiler(), *FLAGS, "-fsyntax-only", f"-I{core}", str(unit)]
        outcomes[more] = subprocess.run(command, capture_output=True, text=True, check=False)
    first, second = outcomes.values()
    assert first.returncode == 0, first.stderr
    assert second.returncode != 0 and "calls linear what is not" in second.stderr, second.stderr
