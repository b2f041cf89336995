"""Current loops of drives: closed forms, saturation against SciPy, energy.

The joints of a gantry do not feel each other: each is a machine by itself.
"""

from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from balance import balance_of
from draws import some
from machines import DC, GANTRY, MOVED, ROTOR, gantry_urdf, write_scene
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from arm_emulator import Plant, Refusal, load_scene
from oracles.reference import solve_states

PERIOD = 2e-3  # s, over which a command is held
SUPPLY = 24.0
ELASTIC, RIGID = {"ratio": 0.01, "stiffness": 2e4, "damping": 20.0}, {"ratio": -0.02}
VISCOUS = {"viscous": 3.0}
WEAK = DC | {"back_emf_constant": 0.04}  # that gives more torque than it takes voltage
GAINS = {"proportional_gain": 2.0, "integral_gain": 900.0, "emf_feedforward": 0.3}
LOOPS: list[dict[str, Any]] = [{"bandwidth": 150.0}, GAINS, {"bandwidth": 400.0}]
LIMIT = 8.0  # A, of the last motor
WINDING = {"heat_capacity": 0.05, "thermal_resistance": 4.0, "magnet_coefficient": -0.002}


def write(folder: Path, scheme: str = "rosenbrock", events: str = "step", **last: Any) -> Path:
    motors = [
        {**WEAK, "current_loop": LOOPS[0]},
        {**WEAK, "current_loop": LOOPS[1]},
        {**WEAK, "current_loop": LOOPS[2], "current_limit": LIMIT, **last},
    ]
    joints = {
        name: {"motor": motor, "gear": gear, "friction": VISCOUS}
        for name, motor, gear in zip(GANTRY, motors, (ELASTIC, ELASTIC, RIGID), strict=True)
    }
    return write_scene(
        folder, gantry_urdf(), joints, energy_flow=True, supply_voltage=SUPPLY,
        integrator={"scheme": scheme, "dt": 1e-4, "events": events},
    )  # fmt: skip


def rows_of(plant: Plant, commands: np.ndarray, period: float = PERIOD) -> np.ndarray:
    """Current, tm, wm, q, v after each command, (K, 5, N)."""
    rows = []
    for u in commands:
        plant.advance(u, round(period / plant.scene.integrator.dt))
        x = plant.state
        rows.append([x.current, x.theta_m, x.omega_m, x.q, x.v])
    return np.array(rows)


def in_closed_form(commands: np.ndarray) -> np.ndarray:
    """The same by matrix exponentials, while no voltage reaches the supply."""
    out = np.zeros((len(commands), 5, 3))
    R, L, Kt, Kb = (
        WEAK[key] for key in ("resistance", "inductance", "torque_constant", "back_emf_constant")
    )
    for j, (loop, M) in enumerate(zip(LOOPS, MOVED, strict=True)):
        w = 2.0 * np.pi * loop.get("bandwidth", 0.0)
        P, I, E = (  # noqa: E741
            (w * L, w * R, Kb) if w else (*list(GAINS.values())[:2], GAINS["emf_feedforward"] * Kb)
        )
        Dl, gear = VISCOUS["viscous"], ELASTIC if j < 2 else RIGID
        Ng, Kg, Dg = gear["ratio"], gear.get("stiffness"), gear.get("damping", 0.0)
        A, b = np.zeros((6, 6)), np.zeros(6)  # of i, x, tm, wm, q, v
        wm = np.eye(6)[3] if Kg else np.eye(6)[5] / Ng
        A[0, :2] = (-P - R) / L, 1.0 / L
        A[0] += (E - Kb) / L * wm
        b[0], A[1, 0], b[1] = P / L, -I, I
        A[4, 5] = 1.0
        if Kg:
            T = np.array([0.0, 0.0, Ng * Kg, Ng * Dg, -Kg, -Dg])
            A[2, 3] = 1.0
            A[3] = -Ng * T / ROTOR
            A[3, 0] = Kt / ROTOR
            A[5] = T / M
            A[5, 5] -= Dl / M
        else:
            inertia = M + ROTOR / Ng**2
            A[5, 0], A[5, 5] = Kt / Ng / inertia, -Dl / inertia
        over = expm(PERIOD * np.block([[A, b[:, None]], [np.zeros((1, 7))]]))
        state = np.zeros(6)
        for k, u in enumerate(commands[:, j]):
            state = over[:6, :6] @ state + over[:6, 6] * u
            out[k, :, j] = state[[0, 2, 3, 4, 5]]
            if not Kg:
                out[k, 1:3, j] = state[4:] / Ng
    return out


@pytest.mark.parametrize(
    ("scheme", "order"), some([("rosenbrock", 2), ("paper", 1), ("implicit", 1)], 1)
)
def test_small_commands_move_it_as_matrix_exponentials_state(
    scheme: str, order: int, tmp_path: Path
) -> None:
    commands = np.random.default_rng(3).uniform(-1.0, 1.0, (12, 3))
    truth = in_closed_form(commands)
    size = np.abs(truth).max(axis=0)
    file, errors = write(tmp_path, scheme), []
    for dt in (1e-4, 5e-5, 2.5e-5):
        plant = Plant(load_scene(file, {"integrator.dt": dt}))
        errors.append(float((np.abs(rows_of(plant, commands) - truth) / size).max()))
    # 0.3 for a quarter, 0.6 for a half: the error's next term.
    for coarse, fine in pairwise(errors):
        assert fine < {1: 0.6, 2: 0.3}[order] * coarse, errors
    assert errors[-1] < {1: 0.1, 2: 2e-3}[order], errors


def test_a_step_is_of_first_order_with_the_bandwidth_at_any_speed(tmp_path: Path) -> None:
    """1 - exp(-2 pi f t): the zero cancels the winding's pole, the EMF is fed forward."""
    for dt, largest in ((4e-5, 4e-3), (2e-5, 1e-3)):
        plant = Plant(load_scene(write(tmp_path), {"integrator.dt": dt}))
        plant.reset(np.zeros(3), [1.0, 1.0, 1.0])  # 4 V of EMF at x, 2 V at z
        u = np.array([3.0, 0.0, 3.0])
        for k in range(1, 40):
            plant.advance(u, round(8e-5 / dt))
            for j in (0, 2):
                rise = -np.expm1(-2.0 * np.pi * LOOPS[j]["bandwidth"] * 8e-5 * k)
                assert plant.state.current[j] == pytest.approx(3.0 * rise, abs=3.0 * largest), j


def commanded() -> np.ndarray:
    """Commands that the supply cannot follow at once, within the limit of the last motor."""
    return np.random.default_rng(5).uniform(-1.0, 1.0, (16, 3)) * [40.0, 30.0, 8.0]


def at_the_supply(file: Path, rows: np.ndarray) -> float:
    """Share of the time, over the joints, that the windings get the whole supply."""
    plant, at, count = Plant(load_scene(file, {"integrator.dt": 2e-5})), 0.0, 0
    before = plant.state.current
    for u in rows:
        for _ in range(100):
            plant.advance(u, 1)
            x = plant.state
            rise = WEAK["inductance"] * (x.current - before) / 2e-5
            volts = rise + WEAK["resistance"] * x.current + 0.04 * x.omega_m
            at += float((np.abs(volts) > 0.97 * SUPPLY).mean())
            before, count = x.current, count + 1
    return at / count


@pytest.mark.parametrize("events", some(["step", "located"], 1))
def test_it_saturates_and_recovers_as_an_independent_solution_does(
    events: str, tmp_path: Path
) -> None:
    rows = commanded()
    file = write(tmp_path, events=events)
    assert 0.1 < at_the_supply(file, rows) < 0.9, "commands that saturate, and some that do not"
    solved = solve_states(load_scene(file), rows, PERIOD, 1e-10, method="DOP853")
    truth, errors = solved[:, [0, 3, 4]], []  # what both has behind any gear
    size = np.abs(truth).max(axis=0)
    for dt in (1e-4, 5e-5, 2.5e-5, 1.25e-5):
        plant = Plant(load_scene(file, {"integrator.dt": dt}))
        result = rows_of(plant, rows)[:, [0, 3, 4]]
        errors.append(float((np.abs(result - truth) / size).max()))
    # Rates do not jump where the voltage meets the supply, so that both keep order 2.
    assert errors[-1] < 0.3**3 * 2.0 * errors[0] and errors[-1] < 5e-3, errors


def by_its_equations(rows: np.ndarray) -> np.ndarray:
    """Current and rise of the winding of the last motor, heated, saturated, behind a rigid gear."""
    out, state = np.zeros((len(rows), 2)), np.zeros(5)  # i, x, q, v, Theta
    w, inertia = 2.0 * np.pi * LOOPS[2]["bandwidth"], MOVED[2] + ROTOR / RIGID["ratio"] ** 2
    L, Kt, Kb = (WEAK[key] for key in ("inductance", "torque_constant", "back_emf_constant"))
    for k, u in enumerate(np.clip(rows[:, 2], -LIMIT, LIMIT)):

        def rates(_: float, y: np.ndarray, u: float = float(u)) -> np.ndarray:
            i, x, _, v, rise = y
            wm, magnets = v / RIGID["ratio"], 1.0 - 0.002 * rise
            R = WEAK["resistance"] * (1.0 + 0.0039 * rise)
            requested = w * L * (u - i) + x + Kb * wm
            V = min(max(requested, -SUPPLY), SUPPLY)
            return np.array([
                (V - R * i - magnets * Kb * wm) / L,
                w * WEAK["resistance"] * (u - i) + WEAK["resistance"] / L * (V - requested),
                v,
                (magnets * Kt * i / RIGID["ratio"] - VISCOUS["viscous"] * v) / inertia,
                (R * i * i - rise / 4.0) / 0.05,
            ])  # fmt: skip

        done = solve_ivp(rates, (0.0, PERIOD), state, "DOP853", rtol=1e-10, atol=1e-12)
        state = done.y[:, -1]
        out[k] = state[[0, 4]]
    return out


@pytest.mark.slow
def test_a_drive_does_not_adapt_to_a_heated_winding(tmp_path: Path) -> None:
    rows = np.random.default_rng(8).uniform(-12.0, 12.0, (20, 3))  # beyond the limit, too
    truth, errors = by_its_equations(rows), []
    file = write(tmp_path, events="located", winding=WINDING)
    assert truth[-1, 1] > 15.0, "it gets hot"
    for dt in (5e-5, 2.5e-5):
        plant, result = Plant(load_scene(file, {"integrator.dt": dt})), []
        for u in rows:
            plant.advance(u, round(PERIOD / dt))
            result.append([plant.state.current[2], plant.winding_temperatures[2] - 20.0])
        errors.append(float(np.abs(np.array(result) - truth).max()))
    assert errors[1] < 5e-3 and errors[1] < 0.35 * errors[0], errors


@pytest.mark.slow
@pytest.mark.parametrize("last", some([{"winding": WINDING}, {}], 1), ids=repr)
def test_energy_is_supplied_less_dissipated_energy(last: dict[str, Any], tmp_path: Path) -> None:
    file, left = write(tmp_path, events="located", **last), []
    for dt in (1e-4, 5e-5, 2.5e-5):
        result = balance_of(Plant(load_scene(file, {"integrator.dt": dt})), commanded(), 20)
        left.append(result.left / result.exchanged)
    assert left[-1] < 1e-4 and left[-1] < 0.15 * left[0], left


def test_commands_are_currents_within_the_limit_and_zero_without_power(tmp_path: Path) -> None:
    scene = load_scene(write(tmp_path))
    plant = Plant(scene)
    assert [joint.unit for joint in scene.joints] == ["A", "A", "A"]
    plant.exchange(np.array([100.0, -50.0, 9.0]))
    assert plant.measured.applied.tolist() == [100.0, -50.0, LIMIT], "the supply bounds no current"
    for _ in range(30):
        plant.exchange(np.array([5.0, -5.0, 5.0]))
    assert plant.state.current == pytest.approx([5.0, -5.0, 5.0], rel=1e-2)
    plant.powered = False
    for _ in range(30):
        plant.exchange(np.array([5.0, -5.0, 5.0]))
    assert plant.state.current == pytest.approx([0.0, 0.0, 0.0], abs=0.1), "the bridge is open"


def test_a_current_that_is_set_flows_on(tmp_path: Path) -> None:
    plant = Plant(load_scene(write(tmp_path)))
    current = np.array([4.0, -3.0, 2.0])
    plant.put("test", {"current": current})
    for _ in range(20):
        plant.advance(current, 1)
        # The second loop feeds 0.3 of the EMF forward, and is not at rest with the motor turning.
        assert plant.state.current == pytest.approx(current, abs=0.2)


@pytest.mark.parametrize(
    ("motor", "line"),
    [
        ({"inductance": 0.0}, "x.motor.current_loop must belong to a motor that has an inductance"),
        ({"current_loop": {}}, "x.motor.current_loop.bandwidth must be given where proportional"),
        ({"current_loop": {"bandwidth": 1.0, "integral_gain": 1.0}}, "integral_gain must be absen"),
        ({"current_loop": {"proportional_gain": 1.0}}, "bandwidth must be given where integral_g"),
        ({"kind": "current"}, "loop must belong to a motor that has an inductance .dc, pmsm., got"),
    ],
)
def test_unusable_current_loops_are_refused(
    motor: dict[str, Any], line: str, tmp_path: Path
) -> None:
    full = {**DC, "current_loop": {"bandwidth": 500.0}, **motor}
    if "kind" in motor:
        del full["resistance"], full["inductance"], full["back_emf_constant"]
    joints = {name: {"motor": full} for name in GANTRY}
    with pytest.raises(Refusal, match=line):
        load_scene(write_scene(tmp_path, gantry_urdf(), joints))
