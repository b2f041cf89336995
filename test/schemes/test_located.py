"""Events that are located within steps: the order survives sticking and current limits."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from balance import balance_of
from draws import some, with_slow
from machines import LINK_INERTIA, make_link_urdf, write_scene
from test_limits import limited_truth, sample_joint

from arm_emulator import Plant, Refusal, load_scene

SECOND_ORDER = ["rosenbrock", "extrapolated"]


def located(scheme: str, dt: float, period: float) -> dict[str, Any]:
    integrator = {"scheme": scheme, "dt": dt, "events": "located"}
    return {"servo_period": period, "integrator": integrator}


@pytest.mark.slow
@pytest.mark.parametrize("scheme", with_slow(SECOND_ORDER, 1))
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
        tmp_path, make_link_urdf(), {"joint": joint}, **located(scheme, period / steps, period)
    )
    plant = Plant(load_scene(file))
    commands = np.where(np.arange(rows) < 3, V, -V)[:, None]
    q = plant.run(commands, steps)[:, 0]
    J, T = LINK_INERTIA + Mm / Ng**2, Kt * V / Ng
    up, down, back = (T - Dc) / J, (T + Dc) / J, (T - Dc) / J
    rotations = 3 * period  # where the torque changes its sign
    rests = rotations + up * rotations / down
    t = period * np.arange(1, rows + 1)
    truth = np.where(
        t <= rotations,
        0.5 * up * t**2,
        0.5 * up * rotations * rests - 0.5 * np.where(t < rests, down, back) * (t - rests) ** 2,
    )
    assert rotations < rests < t[-1] and (rests * steps / period) % 1.0 > 0.1, "within a step"
    # Events are located to 1e-10 of a step.
    np.testing.assert_allclose(q, truth, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("scheme", some(SECOND_ORDER[::-1], 1))
@pytest.mark.parametrize("seed", with_slow(range(2), 1))
def test_currents_at_limits_follow_the_closed_form_with_order_two(
    tmp_path: Path, seed: int, scheme: str
) -> None:
    motor, gear, V = sample_joint(seed)
    truth = limited_truth(motor, gear, V, 0.01)[:, 3]
    errors = []
    for dt in (1e-5, 5e-6, 2.5e-6):
        file = write_scene(
            tmp_path,
            make_link_urdf(),
            {"joint": {"motor": motor, "gear": gear}},
            varied=["joints.*.motor.*", "joints.*.gear.*"],  # one library for all that are drawn
            **located(scheme, dt, 1e-2),
        )
        q = Plant(load_scene(file)).run(V[:, None], round(1e-2 / dt))
        errors.append(float(np.abs(q[:, 0] - truth).max()))
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    # The fastest of these motors has a time constant of 0.1 ms.
    assert orders == pytest.approx(2.0, abs=0.15), errors


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


# Links that stick and slip, and motors at their limits; also of test_backlash.py.
STICKING: dict[str, Any] = {
    "joints.*.friction": {"viscous": 0.5, "coulomb": 5.0, "breakaway": 8.0},
    "joints.*.motor.current_limit": 3.0,
    "gravity": [0.0, 0.0, -9.81],
    "servo_period": 1e-2,
    "integrator.events": "located",
    "energy_flow": True,
}


@pytest.mark.slow
def test_the_balance_of_energy_closes_with_the_order_of_the_scheme() -> None:
    """Given less dissipated is what energy changed, through sticking, slipping and limits."""
    rows = np.random.default_rng(4).uniform(-20.0, 20.0, size=(20, 3))
    left = []
    for steps in (100, 1000, 10_000):
        plant = Plant(load_scene("three_axis", STICKING | {"integrator.dt": 1e-2 / steps}))
        balance = balance_of(plant, rows, steps)
        left.append(balance.left / balance.exchanged)
    # In steps of 0.1 ms the fastest of these motions, of 1e3 1/s, are off by a tenth.
    assert np.log10(np.array(left[:-1]) / left[1:]) == pytest.approx(2.0, abs=0.2), left
    assert left[-1] < 1e-9, left


def test_a_scene_without_energy_flow_reports_none() -> None:
    plant = Plant(load_scene("three_axis"))
    for ask in (lambda: plant.powers(np.ones(3)), lambda: plant.advance_metered(np.ones(3), 10)):
        with pytest.raises(Refusal, match="energy_flow must be true in the scene, got false"):
            ask()
    assert plant.t == 0.0, "a refused call lets time pass"


@pytest.mark.slow
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
    scene = write_scene(tmp_path, make_link_urdf(), {"joint": joint}, energy_flow=True)
    plant = Plant(load_scene(scene))
    for volts in (4.0, 30.0):
        plant.reset()
        plant.advance([volts], 100)
        x, power = plant.state, plant.powers([volts])
        i, wm, v = x.current[0], x.omega_m[0], x.v[0]
        at_limit = i == 3.0
        assert at_limit == (volts == 30.0), f"{i} A at {volts} V"
        applied = 2.0 * i + 0.05 * wm if at_limit else volts
        inputs = applied * i + (0.06 - 0.05) * wm * i
        lost = 2.0 * i**2 + 5.0 * (0.02 * wm - v) ** 2 + 0.5 * v**2 + 1.0 * abs(v)
        assert power.supplied[0] == pytest.approx(inputs, rel=1e-12), "power given [W]"
        assert power.dissipated[0] == pytest.approx(lost, rel=1e-12), "power dissipated [W]"
