"""Friction that grows with the torque of the gear."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from balance import balance_of
from draws import some
from machines import GANTRY, MOVED, gantry_urdf, make_link_urdf, write_scene
from scipy.integrate import solve_ivp
from stick_slip import Towed, assert_order_two
from stick_slip import draw as drawn_stribeck

from arm_emulator import Plant, load_scene
from arm_emulator.machine.schemes.known import SCHEMES

NG = 0.02  # of hoists
HOISTED = 0.2  # kg, of the last link of their gantry
WEIGHTS = 9.81 * NG * HOISTED / 2.0 * MOVED[:2]  # N m at their rotors


def sample_friction(rng: np.random.Generator) -> tuple[dict[str, float], Towed]:
    """A tenth to a third of the spring's torque beside friction that may fall, too."""
    friction, towed = drawn_stribeck(rng)
    mu, Ds, old = float(rng.uniform(0.1, 0.33)), friction["breakaway"], towed.sliding
    if rng.random() < 0.5:
        del friction["stribeck"]

        def old(v: float, _: float) -> float:
            return friction["coulomb"]

    def sliding(v: float, T: float) -> float:
        return old(v, T) + mu * abs(T)

    friction["load"] = mu
    return friction, Towed(towed.stiffness, towed.damping, towed.viscous, towed.speed, sliding,
                           lambda T: Ds + mu * abs(T))  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seed", "scheme"),
    some([(0, "extrapolated"), (1, "rosenbrock"), (2, "rosenbrock"), (3, "extrapolated")], 1),
)
def test_sticking_and_slipping_is_of_order_two_where_located(
    tmp_path: Path, seed: int, scheme: str
) -> None:
    friction, towed = sample_friction(np.random.default_rng([seed, 41]))
    assert_order_two(tmp_path, towed, friction, scheme, stops=1)


def hoists(
    folder: Path, mu: tuple[float, float], scheme: str, dt: float, stiffness: float = 2e4
) -> Plant:
    """Two weights that do not feel each other, behind an elastic gear and behind a rigid one.

    Their motors have no losses of their own; each weight pulls where its motor's angle grows.
    """
    gears = [{"ratio": NG, "stiffness": stiffness, "damping": 3.0}, {"ratio": NG}]
    joints: dict[str, dict[str, Any]] = {GANTRY[2]: {}}
    for name, gear, of_load in zip(GANTRY, gears, mu, strict=False):
        motor = {"resistance": 1.0, "torque_constant": 0.1, "back_emf_constant": 0.0,
                 "rotor_inertia": 1e-4, "friction": {"load": of_load}}  # fmt: skip
        joints[name] = {"motor": motor, "gear": gear}
    file = write_scene(
        folder, gantry_urdf(HOISTED), joints, servo_period=1e-3,
        gravity=[9.81, 9.81, 0.0], integrator={"scheme": scheme, "dt": dt}, varied=["joints.*"],
    )  # fmt: skip
    return Plant(load_scene(file))


@pytest.mark.parametrize("scheme", some(SCHEMES, 1))
def test_motors_need_the_torque_of_the_efficiency_to_lift_and_to_lower(
    tmp_path: Path, scheme: str
) -> None:
    """Behind an elastic gear (1 + mu) and (1 - mu) times the weight; behind a rigid one the load is
    what the motor gives, and the weight over (1 - mu) and (1 + mu)."""
    for eta in (0.9, 0.75, 0.6):
        lifting = WEIGHTS / eta
        lowering = WEIGHTS * np.array([2.0 - 1.0 / eta, 1.0 / (2.0 - eta)])
        plant = hoists(tmp_path, (1.0 / eta - 1.0, 1.0 - eta), scheme, 1e-4)
        for torque, direction in (
            (1.01 * lifting, -1.0), (0.99 * lifting, 0.0), (1.01 * lowering, 0.0),
            (0.99 * lowering, 1.0),
        ):  # fmt: skip
            plant.reset()
            # The weight winds the gear up before the motor takes more or less of it.
            for part in np.linspace(0.0, 1.0, 200):
                holding = part * torque + (1.0 - part) * WEIGHTS
                plant.advance([*(-10.0 * holding), 0.0], 10)
            before = plant.state.theta_m[:2]
            plant.advance([*(-10.0 * torque), 0.0], 10_000)
            moved = plant.state.theta_m[:2] - before
            reported = (
                f"eta {eta}: elastic, rigid: {moved} rad under {torque / WEIGHTS} of the weights"
            )
            # A hundredth of the weight turns it by some rad; held, it yields as the link swings.
            assert (np.abs(moved) < 0.05 if direction == 0.0 else moved * direction > 0.3).all(), (
                reported
            )


@pytest.mark.parametrize("mu", [0.1, 0.5])
def test_a_gear_that_a_step_does_not_resolve_is_followed(tmp_path: Path, mu: float) -> None:
    """Up to a thousand times as stiff as one that is resolved."""
    rows = np.zeros((1000, 3))
    rows[:, :2] = -10.0 * WEIGHTS + np.sin(0.01 * np.arange(1000))[:, None]
    for stiffness in 10.0 ** np.arange(3.0, 8.0):
        coarse, fine = (
            hoists(tmp_path, (mu, mu), "rosenbrock", dt, float(stiffness)) for dt in (1e-3, 2e-5)
        )
        q, truth = coarse.run(rows, 1)[:, :2], fine.run(rows, 50)[:, :2]
        off = np.abs(q - truth).max(axis=0) / np.abs(truth).max(axis=0)
        # Stops and starts cost steps: 1 ms of a swing that takes some tenths of a second.
        assert (off < 0.02).all(), f"{stiffness:g} N m/rad: off by {off} of the way"


@pytest.mark.slow
def test_the_loss_of_a_gear_with_play_closes_the_balance_of_energy(tmp_path: Path) -> None:
    """The torque of load friction jumps where teeth meet and part: at a step's end."""
    rng = np.random.default_rng(44)
    joint = {
        "motor": {
            "kind": "torque", "rotor_inertia": 2e-4, "torque_limit": 0.5,
            "friction": {"coulomb": 0.01, "breakaway": 0.013, "viscous": 1e-5, "load": 0.15},
        },
        "gear": {"ratio": 0.033, "stiffness": 3e3, "damping": 8.0, "backlash": 6e-3},
        "friction": {"viscous": 0.1},
    }  # fmt: skip
    file = write_scene(tmp_path, make_link_urdf(), {"joint": joint}, servo_period=0.01,
                       energy_flow=True, gravity=[0.0, 0.0, -9.81])  # fmt: skip
    rows, left = rng.uniform(-0.3, 0.3, (20, 1)), []
    for steps in (80, 160, 320, 640):
        integrator = {"scheme": "rosenbrock", "events": "located", "dt": 0.01 / steps}
        balance = balance_of(Plant(load_scene(file, {"integrator": integrator})), rows, steps)
        left.append(balance.left / balance.exchanged)
    # Of order 2 it falls by 64 in three halvings, of order 1 by 8; teeth meet some ten times, well
    # or badly within a step.
    assert left[-1] < left[0] / 20.0, f"of what was exchanged, {left}"
    assert left[-1] < 1e-6, f"of what was exchanged, {left}"


@pytest.mark.slow
@pytest.mark.parametrize("scheme", some(["rosenbrock", "extrapolated"], 1))
@pytest.mark.parametrize("events", some(["located", "step"], 1))
def test_an_unloaded_gear_does_not_hold_the_link(tmp_path: Path, scheme: str, events: str) -> None:
    """Three weights whose friction depends on the load alone fall from rest.

    One is behind a rigid gear that nothing drives, one behind an elastic gear that it winds up, and
    one in a gap.
    """
    mu, mass, rotor, stiffness = 0.3, MOVED, 1e-4, 2e4
    motor = {"kind": "torque", "rotor_inertia": rotor, "torque_limit": 1.0}
    elastic = {"ratio": NG, "stiffness": stiffness, "damping": 3.0}
    gears = [{"ratio": NG}, elastic, {**elastic, "backlash": 0.2}]
    joints = {
        name: {"motor": motor, "gear": gear, "friction": {"load": mu}}
        for name, gear in zip(GANTRY, gears, strict=True)
    }
    reflected = rotor / NG**2

    def behind_a_spring(_: float, x: np.ndarray) -> list[float]:
        q, v, rotor_q, rotor_v = x  # of the rotor at the link; the spring only pulls
        T = stiffness * (rotor_q - q) + 3.0 * (rotor_v - v)
        return [v, 9.81 + (T - mu * abs(T)) / mass[1], rotor_v, -T / reflected]

    rows, period = 5, 1e-3
    t = period * np.arange(1, rows + 1)
    spring = solve_ivp(behind_a_spring, (0.0, t[-1]), [0.0] * 4, "DOP853", t[-1:], rtol=1e-11,
                       atol=1e-15)  # fmt: skip
    fall = 0.5 * 9.81 * t[-1] ** 2
    truth = [fall * mass[0] / (mass[0] + reflected), float(spring.y[0, -1]), fall]
    errors = []
    file = write_scene(
        tmp_path, gantry_urdf(), joints, servo_period=period, gravity=[9.81] * 3,
        integrator={"scheme": scheme, "dt": period / 10, "events": events},
    )  # fmt: skip
    for steps in (10, 20, 40):
        plant = Plant(load_scene(file, {"integrator.dt": period / steps}))
        q = plant.run(np.zeros((rows, 3)), steps)
        errors.append(np.abs(q[-1] - truth) / fall)
    assert errors[-1] == pytest.approx(0.0, abs=1e-4), f"of the fall {fall} m: {errors}"
    # Nothing stops on the way, so that `step` has nothing to be late for; it takes the law of the
    # first step from its start, where the spring is not wound up.
    falls = errors[0][1] / errors[-1][1]
    assert falls == pytest.approx(16.0, rel=0.25), f"of order 2 behind the spring: {errors}"
