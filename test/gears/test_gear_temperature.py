"""The temperature of gears: friction heats them, and follows."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from draws import some, with_slow
from machines import LINK_INERTIA, make_link_urdf, write_scene
from scipy.integrate import solve_ivp

from arm_emulator import Plant, Scene, load_scene
from arm_emulator.base.arrays import Array
from arm_emulator.base.refusal import Refusal
from arm_emulator.machine.schemes.known import KNOWN, SCHEMES

PERIOD = 2e-2  # s, over which a voltage is held
STEPS = (20, 40, 80, 160)  # in a period
MOTOR = {
    "resistance": 1.0, "inductance": 2e-3, "torque_constant": 0.1, "back_emf_constant": 0.1,
    "rotor_inertia": 1e-4,
}  # fmt: skip
WINDING = {"heat_capacity": 2.0, "thermal_resistance": 1.5, "resistance_coefficient": 0.0039}
STIFFNESS, DAMPING = 2000.0, 3.0
# On its way, so that no shaft sticks.
START = {"current": 10.0, "omega_m": 20.0, "v": 1.0}


def sample_joint(rng: np.random.Generator, elastic: bool, coupled: bool) -> dict[str, Any]:
    """A joint whose small gear warms by some 10 K within a second."""
    temperature = {
        "heat_capacity": float(rng.uniform(0.3, 1.0)),
        "thermal_resistance": float(rng.uniform(0.5, 3.0)),
        "ambient": float(rng.uniform(0.0, 30.0)),
        "reference": float(rng.uniform(10.0, 30.0)),
        "viscous_floor": float(rng.uniform(0.0, 0.5)),
        "viscous_decay": float(rng.uniform(10.0, 40.0)),
        "dry_coefficient": float(rng.uniform(-0.008, 0.008)),
        **({"winding_resistance": float(rng.uniform(0.5, 2.0))} if coupled else {}),
    }
    gear: dict[str, Any] = {"ratio": 0.05, "thermal": temperature}
    if elastic:
        gear |= {"stiffness": STIFFNESS, "damping": DAMPING}
    return {
        "motor": {**MOTOR, "winding": WINDING,
                  "friction": {"viscous": 2e-4, "coulomb": float(rng.uniform(0.005, 0.02))}},
        "gear": gear,
        "friction": {"viscous": float(rng.uniform(0.5, 2.0)), "coulomb": 1.0, "load": 0.1},
    }  # fmt: skip


def scene_of(
    folder: Path, joint: dict[str, Any], steps: int = 40, scheme: str = "rosenbrock", **keys: Any
) -> Scene:
    file = write_scene(
        folder, make_link_urdf(), {"joint": joint}, servo_period=PERIOD, supply_voltage=1e3,
        integrator={"scheme": scheme, "dt": PERIOD / steps,
                    "events": "located" if KNOWN[scheme].locates else "step"},
        energy_flow=True, **keys,
    )  # fmt: skip
    return load_scene(file)


def solve_motion(joint: dict[str, Any], voltages: Array) -> Array:
    """q, v, rise of the gear and of the winding after each row, of a joint that only turns on."""
    gear, rotor, link = joint["gear"], joint["motor"]["friction"], joint["friction"]
    body, Ng = gear["thermal"], gear["ratio"]
    elastic = "stiffness" in gear

    def rates(_: float, x: Array, V: float) -> list[float]:
        i, tm, wm, q, v, rise, T_rise = x
        R = 1.0 + WINDING["resistance_coefficient"] * T_rise
        above = body["ambient"] + rise - body["reference"]
        f_v = body["viscous_floor"] + (1.0 - body["viscous_floor"]) * np.exp(
            -above / body["viscous_decay"]
        )
        f_d = 1.0 + body["dry_coefficient"] * above
        on_rotor = f_v * rotor["viscous"] * wm + f_d * rotor["coulomb"] * np.sign(wm)
        shaft = 0.1 * i
        T = STIFFNESS * (Ng * tm - q) + DAMPING * (Ng * wm - v) if elastic else shaft / Ng
        dry = f_d * (link["coulomb"] + link["load"] * abs(T))
        on_link = f_v * link["viscous"] * v + dry * np.sign(v)
        P = on_rotor * wm + on_link * v
        flow = 0.0
        if "winding_resistance" in body:
            flow = (20.0 + T_rise - body["ambient"] - rise) / body["winding_resistance"]
        if elastic:
            dwm, dv = (shaft - Ng * T - on_rotor) / 1e-4, (T - on_link) / LINK_INERTIA
        else:
            dv = ((shaft - on_rotor) / Ng - on_link) / (LINK_INERTIA + 1e-4 / Ng**2)
            dwm = dv / Ng
        return [
            (V - R * i - 0.1 * wm) / 2e-3, wm, dwm, v, dv,
            (P + flow - rise / body["thermal_resistance"]) / body["heat_capacity"],
            (R * i**2 - flow - T_rise / WINDING["thermal_resistance"]) / WINDING["heat_capacity"],
        ]  # fmt: skip

    x, out = np.zeros(7), []
    x[0], x[2], x[4] = START["current"], START["omega_m"], START["v"]
    for (V,) in voltages:
        x = solve_ivp(
            rates, (0.0, PERIOD), x, "LSODA", rtol=1e-11, atol=1e-13, args=(V,)
        ).y[:, -1]  # fmt: skip
        out.append(x[[3, 4, 5, 6]])
    return np.array(out)


@pytest.mark.parametrize(
    ("scheme", "elastic", "coupled"),
    with_slow(
        some([(s, e, e == c) for s in SCHEMES for c in (True, False) for e in (True, False)], 4), 1
    ),
)
def test_every_scheme_keeps_its_order(
    tmp_path: Path, scheme: str, elastic: bool, coupled: bool
) -> None:
    rng = np.random.default_rng([SCHEMES.index(scheme), elastic, coupled])
    joint = sample_joint(rng, elastic, coupled)
    voltages = rng.uniform(15.0, 25.0, (25, 1))
    expected = solve_motion(joint, voltages)

    errors = []
    # The first scheme needs steps that are short against the gear's resonance.
    finer = 32 if KNOWN[scheme].order == 1 else 1
    for steps in (finer * count for count in STEPS):
        plant = Plant(scene_of(tmp_path, joint, steps, scheme))
        of_motor = {} if not elastic else {"omega_m": [START["omega_m"]]}
        plant.put("the test", {"current": [START["current"]], "v": [START["v"]], **of_motor})
        q = plant.run(voltages, steps)[:, 0]
        ambient = joint["gear"]["thermal"]["ambient"]
        rises = [plant.gear_temperatures[0] - ambient, plant.winding_temperatures[0] - 20.0]
        errors.append([np.abs(q - expected[:, 0]).max(), *np.abs(rises - expected[-1, 2:])])
    assert expected[-1, 2] > 3.0, "the gear warms"
    orders = np.log2(np.array(errors[0]) / errors[-1]) / 3.0
    assert (orders > KNOWN[scheme].order - 0.3).all(), (orders, errors)
    assert errors[-1][0] < 2e-2 * expected[-1, 0] and errors[-1][1] < 2e-2 * expected[-1, 2]


def driven_at_once(folder: Path, body: dict[str, float], viscous: float, coulomb: float) -> Plant:
    """A joint behind a gear of ratio 1; the numbers are data, so that joints share a library."""
    joint = {
        "motor": {"kind": "torque", "rotor_inertia": 1e-3},
        "gear": {"ratio": 1.0, "thermal": body},
        "friction": {"viscous": viscous, "coulomb": coulomb},
    }
    return Plant(scene_of(folder, joint, 4, varied=["joints.*"]))


@pytest.mark.slow
def test_a_joint_that_warms_for_hours_comes_to_rest_where_losses_leave(tmp_path: Path) -> None:
    """At a constant speed: the rise is Rth times the loss, and viscous friction fell by it."""
    body = {"heat_capacity": 400.0, "thermal_resistance": 0.8, "viscous_decay": 20.0,
            "viscous_floor": 0.2, "dry_coefficient": 0.0}  # fmt: skip
    plant = driven_at_once(tmp_path, body, viscous=4.0, coulomb=2.0)
    plant.run(np.full((180_000, 1), 14.0), 4)  # an hour: 11 times C Rth
    v, rise = float(plant.state.v[0]), float(plant.gear_temperatures[0]) - 20.0
    viscous = 4.0 * (0.2 + 0.8 * np.exp(-rise / 20.0))
    # It comes to rest slower than by C Rth, since losses grow with the speed.
    assert 14.0 == pytest.approx(viscous * v + 2.0, rel=1e-3), "torques"
    assert rise == pytest.approx(0.8 * 14.0 * v, rel=5e-3), "heat"
    assert rise > 30.0 and viscous < 0.45 * 4.0, "it has warmed"


def test_a_joint_that_sticks_breaks_away_at_its_temperature(tmp_path: Path) -> None:
    """Under a steady load: exactly at rest until dry friction has fallen to it."""
    body = {"heat_capacity": 10.0, "thermal_resistance": 1.0, "viscous_decay": 20.0,
            "viscous_floor": 1.0, "dry_coefficient": -0.01}  # fmt: skip
    plant = driven_at_once(tmp_path, body, viscous=0.0, coulomb=5.0)
    for ambient in (20.0, 40.0, 59.9):
        plant.set_parameter("joints.joint.gear.thermal.ambient", ambient)
        plant.run(np.full((200, 1), 3.0), 4)
        assert plant.state.q[0] == 0.0, f"at {ambient} degC it holds 5 (1 - 0.01 (T - 20)) N m"
    plant.set_parameter("joints.joint.gear.thermal.ambient", 60.1)
    plant.run(np.full((200, 1), 3.0), 4)
    assert plant.state.q[0] > 1e-4


@pytest.mark.slow
def test_a_temperature_that_changes_no_friction_changes_no_motion(tmp_path: Path) -> None:
    rng = np.random.default_rng(7)
    joint = sample_joint(rng, elastic=True, coupled=False)
    body = {"heat_capacity": 1.0, "thermal_resistance": 1.0}
    rows = rng.uniform(-25.0, 25.0, (20, 1))
    motions = []
    plain = {key: value for key, value in joint["gear"].items() if key != "thermal"}
    for gear in ({**plain, "thermal": body}, plain):
        motions.append(Plant(scene_of(tmp_path, {**joint, "gear": gear})).run(rows, 40))
    np.testing.assert_allclose(motions[0], motions[1], rtol=0.0, atol=1e-12)


@pytest.mark.parametrize(
    ("changes", "rule"),
    [
        ({"heat_capacity": 0.0}, "heat_capacity.*> 0"),
        ({"thermal_resistance": None}, "thermal_resistance.*nothing"),
        ({"viscous_decay": 1.0}, "viscous_decay"),
        ({"dry_coefficient": 0.1}, "dry_coefficient"),
        ({"winding_resistance": 1.0}, "come with motor.winding"),
    ],
)
def test_refusals(tmp_path: Path, changes: dict[str, Any], rule: str) -> None:
    body = {"heat_capacity": 1.0, "thermal_resistance": 1.0}
    gear = {"ratio": 0.02, "thermal": {**body, **changes}}
    with pytest.raises(Refusal, match=rule):
        scene_of(tmp_path, {"motor": MOTOR, "gear": gear})
