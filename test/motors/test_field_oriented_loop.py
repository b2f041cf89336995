"""Current loops of synchronous motors: a closed form, SciPy beyond the inverter's circle, energy.

The joints of a gantry do not feel each other: each is a machine by itself.
"""

import dataclasses
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from balance import balance_of
from draws import FULL, some
from machines import GANTRY, MOVED, PMSM, ROTOR, gantry_urdf, write_scene
from scipy.integrate import solve_ivp

from arm_emulator import Plant, Refusal, load_scene
from arm_emulator_fleet import Fleet

PERIOD, SUPPLY, VISCOUS = 1e-3, 48.0, 3.0
AMPLITUDE = SUPPLY / math.sqrt(3.0)
ELASTIC, RIGID = {"ratio": 0.01, "stiffness": 2e4, "damping": 20.0}, {"ratio": -0.02}
GEARS = ELASTIC, RIGID, RIGID
LIMIT = 9.0  # A, of the last motor
GAINS = {"proportional_gain": 2.0, "integral_gain": 900.0, "emf_feedforward": 0.3}
LOOPS: list[dict[str, Any]] = [{"bandwidth": 400.0}, GAINS, {"bandwidth": 600.0}]
WINDING = {"heat_capacity": 0.05, "thermal_resistance": 4.0, "magnet_coefficient": -0.002}


def write(folder: Path, scheme: str = "rosenbrock", last: dict[str, Any] | None = None) -> Path:
    motors = [PMSM | {"current_loop": loop} for loop in LOOPS]
    motors[2] |= {"current_limit": LIMIT, **(last or {})}
    joints = {
        name: {"motor": motor, "gear": gear, "friction": {"viscous": VISCOUS}}
        for name, motor, gear in zip(GANTRY, motors, GEARS, strict=True)
    }
    return write_scene(
        folder, gantry_urdf(), joints, energy_flow=True, supply_voltage=SUPPLY,
        servo_period=PERIOD, integrator={"scheme": scheme, "dt": 1e-4},
    )  # fmt: skip


def sample_currents(seed: int, size: float) -> tuple[np.ndarray, np.ndarray]:
    """Currents along the flux and across it, (K, 3) each."""
    d, q = np.random.default_rng(seed).uniform(-size, size, (2, 16, 3))
    return d, q


def solved(u_d: np.ndarray, u_q: np.ndarray, *, heated: bool = False) -> tuple[np.ndarray, float]:
    """id, iq, wm, v after each command (K, 4, 3); and the share of time on the circle."""
    rows, beyond = zip(
        *(solved_joint(j, u_d[:, j], u_q[:, j], heated and j == 2) for j in range(3)), strict=True
    )
    return np.stack(rows, axis=2), float(np.mean(beyond))


def solved_joint(
    j: int, u_d: np.ndarray, u_q: np.ndarray, heated: bool
) -> tuple[np.ndarray, list[bool]]:
    """The same of one joint, from the equations of the pages of the motor and of its loops."""
    R0, Ld, Lq, psi0, p = (
        PMSM[key] for key in ("resistance", "inductance_d", "inductance_q", "flux", "pole_pairs")
    )
    loop, gear = LOOPS[j], GEARS[j]
    w, F = 2.0 * np.pi * loop.get("bandwidth", 0.0), loop.get("emf_feedforward", 1.0)
    P, I = (w * Lq, w * R0) if w else list(GAINS.values())[:2]  # noqa: E741
    Pd = P * Ld / Lq
    Ng, Kg, Dg = gear["ratio"], gear.get("stiffness"), gear.get("damping", 0.0)
    carried = MOVED[j] + (0.0 if Kg else ROTOR / Ng**2)

    def voltages(y: np.ndarray, wm: float, d: float, q: float) -> tuple[float, ...]:
        ask_d = Pd * (d - y[0]) + y[2] - F * p * wm * Lq * y[1]
        ask_q = P * (q - y[1]) + y[3] + F * p * wm * (Ld * y[0] + psi0)
        V_d = min(max(ask_d, -0.95 * AMPLITUDE), 0.95 * AMPLITUDE)
        largest = math.sqrt(AMPLITUDE**2 - V_d**2)
        return ask_d, ask_q, V_d, min(max(ask_q, -largest), largest)

    def rates(_: float, y: np.ndarray, d: float, q: float) -> list[float]:
        i_d, i_q, _, _, tm, wm, x, v, rise = y
        wm = wm if Kg else v / Ng
        R = R0 * (1.0 + 0.0039 * rise) if heated else R0
        psi = psi0 * (1.0 - 0.002 * rise) if heated else psi0
        ask_d, ask_q, V_d, V_q = voltages(y, wm, d, q)
        shaft = 1.5 * p * (psi * i_q + (Ld - Lq) * i_d * i_q)
        T = Kg * (Ng * tm - x) + Dg * (Ng * wm - v) if Kg else shaft / Ng
        return [
            (V_d - R * i_d + p * wm * Lq * i_q) / Ld,
            (V_q - R * i_q - p * wm * (Ld * i_d + psi)) / Lq,
            I * (d - i_d) + I / Pd * (V_d - ask_d),
            I * (q - i_q) + I / P * (V_q - ask_q),
            wm,
            (shaft - Ng * T) / ROTOR if Kg else 0.0,
            v,
            (T - VISCOUS * v) / carried,
            (1.5 * R * (i_d**2 + i_q**2) - rise / 4.0) / 0.05 if heated else 0.0,
        ]

    y, out, beyond = np.zeros(9), [], list[bool]()
    for d, q in zip(u_d.tolist(), u_q.tolist(), strict=True):
        if j == 2:
            d = min(max(d, -LIMIT), LIMIT)
            q = min(max(q, -math.sqrt(LIMIT**2 - d**2)), math.sqrt(LIMIT**2 - d**2))
        done = solve_ivp(
            rates, (0.0, PERIOD), y, "DOP853", rtol=1e-9, atol=1e-11, args=(d, q),
            t_eval=np.linspace(0.0, PERIOD, 21),
        )  # fmt: skip
        for y in done.y.T:
            ask_d, ask_q, V_d, V_q = voltages(y, y[5] if Kg else y[7] / Ng, d, q)
            beyond.append(V_d != ask_d or V_q != ask_q)
        out.append([y[0], y[1], y[5] if Kg else y[7] / Ng, y[7]])
    return np.array(out), beyond


def motion(file: Path, dt: float, u_d: np.ndarray, u_q: np.ndarray) -> np.ndarray:
    plant, rows = Plant(load_scene(file, {"integrator.dt": dt})), []
    for d, q in zip(u_d, u_q, strict=True):
        plant.exchange(q, command_d=d)
        x = plant.state
        rows.append([plant.measured.current_d, x.current, x.omega_m, x.v])
    return np.array(rows)


@pytest.mark.parametrize(
    ("scheme", "order"),
    some([("rosenbrock", 2), ("paper", 1), ("implicit", 1), ("extrapolated", 2)], 1),
)
def test_both_currents_are_of_first_order_at_any_speed(
    scheme: str, order: int, tmp_path: Path
) -> None:
    """1 - exp(-2 pi f t): poles are cancelled, and all that speed induces is fed forward."""
    d, q = np.array([-2.0, 0.0, 1.0]), np.array([2.0, 0.0, -3.0])
    errors, file = [], write(tmp_path, scheme)
    for dt in (5e-5, 2.5e-5):
        plant = Plant(load_scene(file, {"integrator.dt": dt}))
        plant.reset(np.zeros(3), [0.8, 0.0, -1.0])  # 80 and 50 rad/s of the rotors
        worst = 0.0
        for k in range(1, 5):
            plant.exchange(q, command_d=d)
            for j in (0, 2):
                rise = -np.expm1(-2.0 * np.pi * LOOPS[j]["bandwidth"] * PERIOD * k)
                result = np.array([plant.measured.current_d[j], plant.state.current[j]])
                worst = max(worst, float(np.abs(result - rise * np.array([d[j], q[j]])).max()))
        errors.append(worst)
    assert errors[1] < {1: 0.6, 2: 0.3}[order] * errors[0], errors
    assert errors[1] < {1: 0.05, 2: 5e-3}[order], errors


@pytest.mark.parametrize("heated", some([False, True], 1))
def test_it_saturates_and_recovers_as_an_independent_solution_does(
    heated: bool, tmp_path: Path
) -> None:
    u_d, u_q = sample_currents(5, 25.0)
    truth, beyond = solved(u_d, u_q, heated=heated)
    assert 0.1 < beyond < 0.9, "commands beyond the circle, and some within"
    size = np.abs(truth).max(axis=0)
    file = write(tmp_path, last={"winding": WINDING} if heated else None)
    errors = [
        float((np.abs(motion(file, dt, u_d, u_q) - truth) / size).max())
        for dt in (5e-5, 2.5e-5, 1.25e-5, 6.25e-6)
    ]
    # Rates do not jump at the circle, so that order 2 stays; kinks within a step scatter it.
    assert errors[-1] < 0.35**3 * errors[0] and errors[-1] < 2e-3, errors


def test_order_two_holds_where_the_axis_along_the_flux_takes_all_of_its_voltage(
    tmp_path: Path,
) -> None:
    """Steps of `command_d` that ask for more than the circle, beside currents across the flux."""
    rng = np.random.default_rng(11)
    u_d = 30.0 * np.tile([[1.0], [0.0], [-1.0], [0.0]], (4, 3)) * rng.uniform(0.8, 1.2, (16, 3))
    u_q = rng.uniform(-4.0, 4.0, (16, 3))
    truth, beyond = solved(u_d, u_q)
    assert beyond > 0.1, "share of the time at the circle"
    size, file = np.abs(truth).max(axis=0), write(tmp_path)
    errors = [
        float((np.abs(motion(file, dt, u_d, u_q) - truth) / size).max()) for dt in (2e-5, 5e-7)
    ]
    # A fortieth of the step: a factor of 1600 in second order, and of 250 in order 3/2, which an
    # unbounded slope at the circle leaves. Kinks within a step scatter them by a factor of 2.
    assert errors[1] < errors[0] / 800.0, errors


@pytest.mark.parametrize("heated", some([False, True], 1))
def test_energy_is_supplied_less_dissipated_energy(heated: bool, tmp_path: Path) -> None:
    _, u_q = sample_currents(6, 25.0)
    file = write(tmp_path, last={"winding": WINDING} if heated else None)
    left = []
    for dt in (1e-4, 5e-5, 2.5e-5):
        plant = Plant(load_scene(file, {"integrator.dt": dt}))
        plant.exchange(u_q[0], command_d=[-4.0, 3.0, -2.0])  # held from here on
        result = balance_of(plant, u_q, round(PERIOD / dt))
        left.append(result.left / result.exchanged)
    # A quarter per halving, scattered by the kinks at the circle.
    assert left[-1] < 1e-4 and left[-1] < 0.15 * left[0], left


@pytest.mark.skipif(not FULL, reason="lanes are compiled once more for it: make test-in-full")
@pytest.mark.parametrize("scheme", ["rosenbrock", "extrapolated", "paper", "implicit"])
def test_arms_in_lanes_are_those_by_themselves(scheme: str, tmp_path: Path) -> None:
    scene = load_scene(write(tmp_path, scheme))
    arms, (u_d, u_q) = 5, sample_currents(7, 25.0)
    fleet, alone = Fleet(scene, arms), [Plant(scene) for _ in range(arms)]
    share = np.linspace(0.2, 1.0, arms)[:, None]
    for d, q in zip(u_d, u_q, strict=True):
        fleet.exchange(share * q, command_d=share * d)
        for plant, part in zip(alone, share, strict=True):
            plant.exchange(part * q, command_d=part * d)
    state = fleet.state
    for field in ("current", "omega_m", "q", "v"):
        rows = np.array([getattr(plant.state, field) for plant in alone])
        # Lanes and a single arm differ in the order of sums alone.
        np.testing.assert_allclose(getattr(state, field), rows, rtol=1e-9, atol=1e-12)


def test_commands_are_currents_within_the_limits_circle(tmp_path: Path) -> None:
    scene = load_scene(write(tmp_path))
    plant = Plant(scene)
    assert [joint.unit for joint in scene.joints] == ["A"] * 3
    plant.exchange([100.0, -50.0, 9.0], command_d=[-5.0, 300.0, -4.0])
    measured = plant.measured
    assert measured.applied == pytest.approx([100.0, -50.0, math.sqrt(LIMIT**2 - 16.0)])
    assert measured.applied_d.tolist() == [-5.0, 300.0, -4.0]
    plant.exchange([0.0, 0.0, 5.0], command_d=[0.0, 0.0, -20.0])
    assert plant.measured.applied_d[2] == -LIMIT
    assert plant.measured.applied[2] == 0.0, "nothing of the circle is left"
    plant.powered = False
    for _ in range(30):
        plant.exchange(np.full(3, 5.0), command_d=np.full(3, 5.0))
    assert plant.state.current == pytest.approx(np.zeros(3), abs=0.1)
    assert plant.measured.current_d == pytest.approx(np.zeros(3), abs=0.1)


def test_the_data_that_a_servo_needs_of_it(tmp_path: Path) -> None:
    joint = load_scene(write(tmp_path)).joints[0]
    data = joint.servo_data
    assert data is not None and dataclasses.asdict(data)["current_bandwidth"] == 400.0
    torque = 1.5 * PMSM["pole_pairs"] * PMSM["flux"]
    assert joint.torque_per_command == pytest.approx(torque / ELASTIC["ratio"])


def test_a_current_limit_without_a_loop_is_refused(tmp_path: Path) -> None:
    joints = {name: {"motor": PMSM | {"current_limit": 5.0}} for name in GANTRY}
    line = r"x\.motor\.current_limit must come with a current_loop, whose commands it bounds, got 5"
    with pytest.raises(Refusal, match=line):
        load_scene(write_scene(tmp_path, gantry_urdf(), joints))
