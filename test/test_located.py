"""Events that are located within steps: the order survives sticking and current limits."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from draws import some
from machines import LINK_INERTIA, one_link_urdf, write_scene
from test_limits import drawn_joint, drawn_three_axis, limited_truth

from arm_emulator import Plant, Refusal, load_scene
from arm_emulator.base.arrays import Array
from oracles.reference import reference

SECOND_ORDER = ["rosenbrock", "extrapolated"]


def located(scheme: str, dt: float, period: float) -> dict[str, Any]:
    integrator = {"scheme": scheme, "dt": dt, "events": "located"}
    return {"servo_period": period, "integrator": integrator}


def belt(rng: np.random.Generator) -> tuple[dict[str, float], dict[str, float], float]:
    """Friction, spring and speed of a mass that rubs on the ground and is towed by a spring.

    The spring is strong enough beside friction that the mass stops within its first half swing.
    """
    I, Kg = LINK_INERTIA, float(10 ** rng.uniform(1, 3))  # noqa: E741
    Dc = float(rng.uniform(0.5, 3.0))
    friction = {"coulomb": Dc, "breakaway": Dc * float(rng.choice([1.0, rng.uniform(1.2, 2.0)]))}
    speed = float(Dc / np.sqrt(Kg * I) * rng.uniform(0.3, 0.9))
    return friction, {"ratio": 1.0, "stiffness": Kg}, speed


def belt_truth(
    friction: dict[str, float], gear: dict[str, float], speed: float, t: Array
) -> tuple[Array, int]:
    """Position of the mass, and how often it stopped.

    The spring's twist u is Dc/Kg plus a harmonic oscillation while the mass slides. It begins at
    the belt's speed with u = 0. It stops where du/dt is the belt's speed, and it breaks away where
    Kg u is the breakaway torque.
    """
    I, Kg, Dc, Ds = LINK_INERTIA, gear["stiffness"], friction["coulomb"], friction["breakaway"]  # noqa: E741
    w, begin, out, stops = np.sqrt(Kg / I), 0.0, np.full_like(t, np.nan), 0
    A, B = -Dc / Kg, 0.0  # u = Dc/Kg + A cos w(t - begin) + B sin w(t - begin)
    stop = np.arcsin(speed * Kg / (Dc * w)) / w
    while begin < t[-1]:
        here = (t >= begin) & (t <= begin + stop)
        s = w * (t[here] - begin)
        out[here] = speed * t[here] - (Dc / Kg + A * np.cos(s) + B * np.sin(s))
        stops += begin + stop < t[-1]
        twist = Dc / Kg + A * np.cos(w * stop) + B * np.sin(w * stop)
        begin += stop
        rest = speed * begin - twist
        away = begin + (Ds / Kg - twist) / speed
        out[(t >= begin) & (t <= away)] = rest
        A, B, begin = (Ds - Dc) / Kg, speed / w, away
        if A == 0.0:  # from here on the mass moves with the belt's speed, less a swing to rest
            stop = 2.0 * np.pi / w
        else:
            stop = 2.0 * (np.pi - np.arctan(A * w / speed)) / w
    return out, stops


@pytest.mark.parametrize(
    ("seed", "scheme"),
    some([(0, "rosenbrock"), (1, "extrapolated"), (0, "extrapolated"), (1, "rosenbrock")], 1),
)
def test_sticking_and_slipping_follow_the_closed_form_with_order_two(
    tmp_path: Path, seed: int, scheme: str
) -> None:
    """A rotor that nothing can slow down tows its link through a soft gear."""
    rng = np.random.default_rng(seed)
    friction, gear, speed = belt(rng)
    swing = 2.0 * np.pi * np.sqrt(LINK_INERTIA / gear["stiffness"])
    rotor = 1e14  # kg m2: in a second 1 N m moves it by less than rounding
    motor = {"resistance": 1.0, "torque_constant": 0.1, "back_emf_constant": 0.0}
    joint = {"motor": {**motor, "rotor_inertia": rotor}, "gear": gear, "friction": friction}
    period, rows = float(round(swing / 7.3, 9)), 30
    t = period * np.arange(1, rows + 1)
    truth, stops = belt_truth(friction, gear, speed, t)
    assert stops >= 2, "the mass shall stick and slip"
    errors = []
    for steps in (20, 40, 80, 160):
        file = write_scene(
            tmp_path, one_link_urdf(), {"joint": joint}, **located(scheme, period / steps, period)
        )
        plant = Plant(load_scene(file))
        plant.reset(v=[speed])
        q = plant.run(np.zeros((rows, 1)), steps)[:, 0]
        errors.append(float(np.abs(q - truth).max()))
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    # The next term of the error's expansion is a few per cent of it with 140 steps a swing.
    assert orders == pytest.approx(2.0, abs=0.15), errors


@pytest.mark.parametrize("scheme", ["rosenbrock", "extrapolated"])
def test_a_rotor_reverses_with_its_link_on_parabolas(tmp_path: Path, scheme: str) -> None:
    """A constant torque against dry friction, then the opposite one, behind a rigid gear.

    Accelerations are constant between events, so that a scheme of order two is exact, also in the
    step after an event: its past must have the torque that accelerates the rotor.
    """
    Kt, Ng, Mm, V, Dc = 0.1, 0.01, 5e-5, 6.0, 17.0
    motor = {"resistance": 1.0, "torque_constant": Kt, "back_emf_constant": 0.0}
    joint = {"motor": motor | {"rotor_inertia": Mm}, "gear": {"ratio": Ng}}
    joint["friction"] = {"coulomb": Dc}
    period, rows, steps = 0.013, 8, 4
    file = write_scene(
        tmp_path, one_link_urdf(), {"joint": joint}, **located(scheme, period / steps, period)
    )
    plant = Plant(load_scene(file))
    commands = np.where(np.arange(rows) < 3, V, -V)[:, None]
    q = plant.run(commands, steps)[:, 0]
    J, T = LINK_INERTIA + Mm / Ng**2, Kt * V / Ng
    up, down, back = (T - Dc) / J, (T + Dc) / J, (T - Dc) / J
    turns = 3 * period  # where the torque changes its sign
    rests = turns + up * turns / down
    t = period * np.arange(1, rows + 1)
    truth = np.where(
        t <= turns,
        0.5 * up * t**2,
        0.5 * up * turns * rests - 0.5 * np.where(t < rests, down, back) * (t - rests) ** 2,
    )
    assert turns < rests < t[-1] and (rests * steps / period) % 1.0 > 0.1, "within a step"
    # Events are located to 1e-10 of a step.
    np.testing.assert_allclose(q, truth, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("scheme", some(SECOND_ORDER[::-1], 1))
@pytest.mark.parametrize("seed", range(2))
def test_currents_at_limits_follow_the_closed_form_with_order_two(
    tmp_path: Path, seed: int, scheme: str
) -> None:
    motor, gear, V = drawn_joint(seed)
    truth = limited_truth(motor, gear, V, 0.01)[:, 3]
    errors = []
    for dt in (1e-5, 5e-6, 2.5e-6):
        file = write_scene(
            tmp_path,
            one_link_urdf(),
            {"joint": {"motor": motor, "gear": gear}},
            varied=["joints.*.motor.*", "joints.*.gear.*"],  # one library for all that are drawn
            **located(scheme, dt, 1e-2),
        )
        q = Plant(load_scene(file)).run(V[:, None], round(1e-2 / dt))
        errors.append(float(np.abs(q[:, 0] - truth).max()))
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    # The fastest of these motors has a time constant of 0.1 ms.
    assert orders == pytest.approx(2.0, abs=0.15), errors


@pytest.mark.parametrize("seed", some([2, 1], 1))
def test_motors_far_faster_than_a_step_are_followed_where_events_are_located(seed: int) -> None:
    """Light rotors without inductance that reach and leave their limits within one step."""
    scene, voltages = drawn_three_axis(seed, "rosenbrock", 1e-3)
    truth = reference(scene, voltages, 0.02, 1e-10, method="LSODA")
    scene, _ = drawn_three_axis(seed, "rosenbrock", 1e-3, events="located")
    q = Plant(scene).run(voltages, 20)
    # As for steps that are not cut, test_limits.py.
    way = np.abs(truth - scene.start).max()
    assert np.abs(q - truth).max() < 0.03 * way, f"of a way of {way:.3g} rad"


def test_without_events_nothing_is_cut() -> None:
    """A machine without dry friction and limits has the same bits either way."""
    voltages = np.random.default_rng(3).uniform(-20.0, 20.0, size=(20, 3))
    runs = [
        Plant(load_scene("three_axis", overrides={"integrator.events": events})).run(voltages, 10)
        for events in ("step", "located")
    ]
    assert (runs[0] == runs[1]).all(), "the motion of a smooth machine has changed"


@pytest.mark.parametrize(
    ("overrides", "rule"),
    [
        ({"integrator.scheme": "implicit"}, "of first order"),
        ({"integrator.scheme": "paper"}, "of first order"),
        ({"integrator.scheme": "extrapolated", "threads": 2}, "an earlier sample"),
    ],
)
def test_schemes_that_cannot_locate_events_are_refused(
    overrides: dict[str, Any], rule: str
) -> None:
    with pytest.raises(Refusal, match=f"integrator.events must be step with .*{rule}"):
        load_scene("three_axis", overrides={**overrides, "integrator.events": "located"})


def test_the_balance_of_energy_closes_with_the_order_of_the_scheme() -> None:
    """Given less dissipated is what energy changed, through sticking, slipping and limits."""
    rng = np.random.default_rng(4)
    rows = rng.uniform(-20.0, 20.0, size=(20, 3))
    overrides = {
        "joints.*.friction": {"viscous": 0.5, "coulomb": 5.0, "breakaway": 8.0},
        "joints.*.motor.current_limit": 3.0,
        "gravity": [0.0, 0.0, -9.81],
        "servo_period": 1e-2,
        "integrator.events": "located",
        "energy_flow": True,
    }
    left = []
    for steps in (100, 1000, 10_000):
        at = {**overrides, "integrator.dt": 1e-2 / steps}
        plant = Plant(load_scene("three_axis", overrides=at))
        change, exchanged = -plant.energy, 0.0
        for V in rows:
            flow = plant.advance_metered(V, steps)
            change -= flow.given.sum() - flow.dissipated.sum()
            exchanged += np.abs(flow.given).sum() + flow.dissipated.sum()
        left.append(abs(change + plant.energy) / exchanged)
    # In steps of 0.1 ms the fastest of these motions, of 1e3 1/s, are off by a tenth.
    assert np.log10(np.array(left[:-1]) / left[1:]) == pytest.approx(2.0, abs=0.2), left
    assert left[-1] < 1e-9, left


def test_a_scene_without_energy_flow_reports_none() -> None:
    plant = Plant(load_scene("three_axis"))
    for ask in (lambda: plant.powers(np.ones(3)), lambda: plant.advance_metered(np.ones(3), 10)):
        with pytest.raises(Refusal, match="energy_flow must be true in the scene, got false"):
            ask()
    assert plant.t == 0.0, "a refused call lets time pass"


def test_powers_are_those_of_the_equations(tmp_path: Path) -> None:
    """A motor within its limit and one at it, both with friction and a damped gear."""
    motor = {
        "resistance": 2.0,
        "inductance": 1e-3,
        "torque_constant": 0.06,
        "back_emf_constant": 0.05,
        "rotor_inertia": 1e-4,
        "current_limit": 3.0,
    }
    gear = {"ratio": 0.02, "stiffness": 2e3, "damping": 5.0}
    friction = {"viscous": 0.5, "coulomb": 1.0}
    joint = {"motor": motor, "gear": gear, "friction": friction}
    scene = write_scene(tmp_path, one_link_urdf(), {"joint": joint}, energy_flow=True)
    plant = Plant(load_scene(scene))
    for volts in (4.0, 30.0):
        plant.reset()
        plant.advance([volts], 100)
        x, power = plant.state, plant.powers([volts])
        i, wm, v = x.current[0], x.omega_m[0], x.v[0]
        at_limit = i == 3.0
        assert at_limit == (volts == 30.0), f"{i} A at {volts} V"
        applied = 2.0 * i + 0.05 * wm if at_limit else volts
        given = applied * i + (0.06 - 0.05) * wm * i
        lost = 2.0 * i**2 + 5.0 * (0.02 * wm - v) ** 2 + 0.5 * v**2 + 1.0 * abs(v)
        assert power.given[0] == pytest.approx(given, rel=1e-12), "power given [W]"
        assert power.dissipated[0] == pytest.approx(lost, rel=1e-12), "power dissipated [W]"
