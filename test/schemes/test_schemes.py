"""The schemes against an independent solution: orders, limits, friction."""

import tempfile
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from draws import some, with_slow
from machines import (
    GRAVITY,
    LINK_INERTIA,
    MOTOR,
    list_moving_joints,
    make_link_urdf,
    write_random_chain,
    write_scene,
)
from scipy.linalg import expm

from arm_emulator import Plant, Refusal, Scene, load_scene
from arm_emulator.machine.schemes.known import KNOWN, SCHEMES
from oracles.reference import solve_positions, solve_states

PERIOD = 1e-2  # s, over which a voltage is held
ROWS = 30

RIGID = {"joints.*.gear.stiffness": None, "joints.*.gear.damping": None}
NO_INDUCTANCE = {"joints.*.motor.inductance": None}
VARIED = ["joints.*"]
MACHINES: dict[str, dict[str, Any]] = {
    "everything": {},
    "rigid gear, no inductance": {**RIGID, **NO_INDUCTANCE},
    "gear without damping": {"joints.*.gear.damping": 0.0},
    "gravity and payload": {
        "gravity": [1.0, 2.0, -9.0],
        "payload": {
            "mass": 1.0,
            "com": [0.01, 0.02, 0.05],
            "inertia": [0.01, 0.02, 0.015, 0.001, 0.002, -0.003],
        },
    },
    "no motors": {
        "joints.*.motor": None,
        "joints.*.gear": None,
        "joints.*.encoder": None,
        "gravity": [0.0, 0.0, -9.81],
    },
    "random chain": {},
    "rigid gear": RIGID,
    "no inductance": NO_INDUCTANCE,
}


def random_scene() -> Path:
    """A chain of four random joints, prismatic ones among them, with motors, and gravity aslant."""
    folder = Path(tempfile.mkdtemp())
    urdf = write_random_chain(np.random.default_rng(11), 4)
    gear = {"ratio": 0.02, "stiffness": 5e3, "damping": 20.0}
    names = list_moving_joints(urdf)
    assert any("prismatic" in name for name in names), f"no prismatic joint among {names}"
    joint = {"motor": MOTOR, "gear": gear, "friction": {"viscous": 0.5}}
    return write_scene(folder, urdf, dict.fromkeys(names, joint), gravity=GRAVITY)


@cache
def scene_file(machine: str) -> str:
    return str(random_scene()) if machine == "random chain" else "three_axis"


def scene(machine: str, scheme: str, steps: int, **overrides: Any) -> Scene:
    """Return a machine; those that differ from another in numbers only share its library."""
    integrator = {
        "varied": VARIED,
        "integrator.scheme": scheme,
        "integrator.dt": PERIOD / steps,
        "servo_period": PERIOD,
    }
    return load_scene(
        scene_file(machine), overrides={**integrator, **MACHINES[machine], **overrides}
    )


def voltages(joints: int) -> np.ndarray:
    """A sine per joint that starts with a jump, so that currents and gears are stirred up."""
    t = PERIOD * np.arange(ROWS)[:, None]
    j = np.arange(joints)
    return 12.0 * np.sin(2.0 * np.pi * (0.5 + 0.3 * j) * t + 0.5 + j)


@cache
def truth(machine: str) -> np.ndarray:
    machine_scene = scene(machine, "paper", 100)
    return solve_positions(
        machine_scene,
        voltages(len(machine_scene.joints)),
        PERIOD,
        payload=MACHINES[machine].get("payload"),
    )


def motion(machine: str, scheme: str, steps: int, **overrides: Any) -> np.ndarray:
    plant = Plant(scene(machine, scheme, steps, **overrides))
    return plant.run(voltages(len(plant.scene.joints)), steps)


def error(machine: str, scheme: str, steps: int) -> float:
    return float(np.abs(motion(machine, scheme, steps) - truth(machine)).max())


# The reference


def test_reference_by_three_methods() -> None:
    """Implicit, explicit and of many steps: what they agree on is no matter of method."""
    machine = scene("everything", "paper", 100)
    rows = voltages(3)[:2]
    explicit = solve_positions(machine, rows, PERIOD, 1e-9, method="DOP853")
    # Each makes an error of 1e-9 per step at most, in some hundred steps that damping forgets.
    for method in ("Radau", "LSODA"):
        motion_by_method = solve_positions(machine, rows, PERIOD, 1e-9, method=method)
        assert motion_by_method == pytest.approx(explicit, abs=1e-9), (
            f"motions by {method} and by DOP853"
        )


@pytest.mark.parametrize("rigid", [False, True], ids=["elastic", "rigid"])
@pytest.mark.parametrize("L", [1e-3, 0.0], ids=["RL", "R"])
def test_reference_equals_the_closed_form(tmp_path: Path, rigid: bool, L: float) -> None:
    """One joint without gravity is linear: x(t) by the matrix exponential of (1), (2) and (4)."""
    R, K, Mm, Ng, Kg, Dg, Dl, M = 1.0, 0.05, 1e-4, 0.01, 1e4, 10.0, 0.5, 0.05 + 2.0 * 0.3**2
    motor = {
        "resistance": R,
        "inductance": L,
        "torque_constant": K,
        "back_emf_constant": K,
        "rotor_inertia": Mm,
    }
    gear = {"ratio": Ng} if rigid else {"ratio": Ng, "stiffness": Kg, "damping": Dg}
    joint = {"motor": motor, "gear": gear, "friction": {"viscous": Dl}}
    machine = load_scene(write_scene(tmp_path, make_link_urdf(), {"joint": joint}))
    V = 10.0
    # Rows of (i, tm, wm, q, v, 1); without L the current's row is its steady value inserted.
    i = np.array([1.0, 0, 0, 0, 0, 0]) if L else np.array([0, 0, -K / R, 0, 0, V / R])
    if rigid:
        i[4], i[2] = i[2] / Ng, 0.0
        wm = np.array([0, 0, 0, 0, 1.0 / Ng, 0])
        dv = (K / Ng * i - Dl * np.eye(6)[4]) / (M + Mm / Ng**2)
        motor_rows = [np.zeros(6), np.zeros(6)]
    else:
        wm = np.eye(6)[2]
        T = np.array([0, Kg * Ng, Dg * Ng, -Kg, -Dg, 0])
        dv = (T - Dl * np.eye(6)[4]) / M
        motor_rows = [wm, (K * i - Ng * T) / Mm]
    di = (V * np.eye(6)[5] - R * i - K * wm) / L if L else np.zeros(6)
    A = np.array([di, *motor_rows, np.eye(6)[4], dv, np.zeros(6)])
    states = solve_states(machine, np.full((10, 1), V), PERIOD)
    for k, state in enumerate(states):
        exact = expm(A * PERIOD * (k + 1))[:5, 5]
        # 1e-11 of the largest entry, the motor's 90 rad/s, in each of a hundred steps.
        at = f"after period {k + 1}"
        assert state[:, 0] == pytest.approx(exact, abs=1e-9), f"current, motor, link {at}"
        assert state[3:, 0] == pytest.approx(exact[3:], abs=1e-11), f"link {at}"


def test_reference_states_the_parts_that_it_cannot_solve() -> None:
    for overrides in (
        {"joints.*.friction.coulomb": 1.0},
        {"joints.*.motor.current_limit": 1.0},
        {"payload": {"mass": 1.0}},  # a loaded scene does not state where its payload is
    ):
        with pytest.raises(Refusal, match="reference: "):
            solve_positions(scene("everything", "paper", 100, **overrides), voltages(3), PERIOD)


# Orders

# Every scheme on the machine that has all, a scheme on the others; then all of both orders.
PAIRS = [
    *(("everything", scheme) for scheme in SCHEMES),
    *((machine, SCHEMES[(k + half) % len(SCHEMES)])
      for half in (0, 2, 1, 3) for k, machine in enumerate(list(MACHINES)[1:])),
]  # fmt: skip


@pytest.mark.parametrize(("machine", "scheme"), with_slow(some(PAIRS, 4 + (len(MACHINES) - 3)), 4))
def test_orders(machine: str, scheme: str) -> None:
    # The next term of the error's expansion is one order higher: at 12 us and below it is some per
    # cent of the first for the fastest motions of these machines (300 rad/s without damping).
    coarse, fine = (error(machine, scheme, steps) for steps in (800, 1600))
    assert np.log2(coarse / fine) == pytest.approx(KNOWN[scheme].order, abs=0.06), (
        "order of the error"
    )
    # A constant of the right size: the motions have accelerations of 10 rad/s2 (1e3 1/s3).
    assert fine < {1: 1e-3, 2: 1e-6}[KNOWN[scheme].order], "error of the fine step [rad or m]"


@pytest.mark.slow
def test_ten_milliseconds_are_enough_for_rosenbrock() -> None:
    """At dt = 10 ms three_axis is within 5e-4 rad after 1 s."""
    machine = scene("everything", "rosenbrock", 1)
    t = PERIOD * np.arange(100)[:, None]
    rows = 12.0 * np.sin(2.0 * np.pi * (0.5 + 0.3 * np.arange(3)) * t + np.arange(3))
    exact = solve_positions(machine, rows, PERIOD, 1e-6)
    assert Plant(machine).run(rows, 1)[-1] == pytest.approx(exact[-1], abs=5e-4), "arm after 1 s"


# Limits


@pytest.mark.slow
@pytest.mark.parametrize("scheme", some(["rosenbrock", "implicit", "extrapolated"], 1))
def test_stiff_gears_converge_to_the_rigid_gear(scheme: str) -> None:
    """The wind-up is T / Kg."""
    rigid = motion("rigid gear", scheme, 200)
    away = [
        np.abs(motion("everything", scheme, 200, **{"joints.*.gear.stiffness": Kg}) - rigid).max()
        for Kg in (1e6, 1e7, 1e8)
    ]
    # T = 20 N m, and some overshoot.
    assert away[0] < 5e-5, f"distances from the rigid gear [rad]: {away}"
    # The largest difference is a peak of the gears' ringing after the first jump of the voltage,
    # seen every 10 ms: its height over T / Kg changes by up to 15 % with the frequency.
    falls = [away[0] / away[1], away[1] / away[2]]
    assert falls == pytest.approx([10.0, 10.0], abs=2.0), "distances per ten times the stiffness"


@pytest.mark.parametrize("scheme", SCHEMES)
def test_small_inductances_converge_to_none(scheme: str) -> None:
    """The current lags by L/R."""
    none = motion("no inductance", scheme, 200)
    away = [
        np.abs(motion("everything", scheme, 200, **{"joints.*.motor.inductance": L}) - none).max()
        for L in (1e-6, 1e-7, 1e-8)
    ]
    assert away[0] < 5e-6, f"1 us at 2 rad/s; distances from no inductance [rad]: {away}"
    # Linear in L as far as L/R is short beside the step of 50 us: 2 % at 1e-6.
    falls = [away[0] / away[1], away[1] / away[2]]
    assert falls == pytest.approx([10.0, 10.0], rel=0.05), "distances per tenth of the inductance"


# Nonsmooth parts


@pytest.mark.slow
@pytest.mark.parametrize(
    "overrides",
    [
        {"joints.*.friction": {"viscous": 0.5, "coulomb": 5.0, "breakaway": 8.0}},
        {"joints.*.motor.current_limit": 3.0, **RIGID},
    ],
    ids=["dry friction", "limit with rigid gear"],
)
def test_first_order_remains_where_friction_and_limits_bend(overrides: dict[str, Any]) -> None:
    """All schemes meet at the same motion; the instant of a switch is known to one step.

    Limits behind elastic gears: test_limits.py.
    """
    t = PERIOD * np.arange(ROWS)[:, None]
    rows = 12.0 * np.sin(2.0 * np.pi * (1.5 + 0.3 * np.arange(3)) * t + np.arange(3))

    def run(scheme: str, steps: int) -> np.ndarray:
        return Plant(scene("everything", scheme, steps, **overrides)).run(rows, steps)

    fine = run("rosenbrock", 10_000)
    for scheme in some(SCHEMES, 1):
        errors = np.array([np.abs(run(scheme, n) - fine).max() for n in (50, 400)])
        # Eight times the steps: an eighth of the error; a switch may fall well or badly into its
        # step, which for the second order is nearly all of the (small) error.
        reported = f"{scheme}, errors of coarse and fine steps [rad]: {errors}"
        assert errors[0] / errors[1] > (6.0 if KNOWN[scheme].order == 1 else 2.0), reported
        assert errors[1] < (2e-4 if KNOWN[scheme].order == 1 else 2e-5), reported


def sliding(folder: Path, scheme: str, dt: float, friction: dict[str, float]) -> Plant:
    """A link with friction, without weight."""
    file = write_scene(
        folder, make_link_urdf(), {"joint": {"friction": friction}},
        varied=VARIED,
    )  # fmt: skip
    return Plant(load_scene(file, {"integrator.scheme": scheme, "integrator.dt": dt}))


@pytest.mark.parametrize(("scheme", "twice"), with_slow([("paper", -1), ("implicit", 1)], 1))
def test_euler_s_methods_go_by_the_speed_at_the_step_s_begin_or_end(
    tmp_path: Path, scheme: str, twice: int
) -> None:
    """Under a constant acceleration q is a h^2 (k^2 -+ k) / 2 after k steps.

    The paper's links go forward, by the speed at the begin; implicit Euler by that at the end. The
    order alone does not distinguish them.
    """
    Kt, V, Ng, Mm, h = 0.05, 8.0, 0.02, 1e-4, 1e-3
    motor = {"resistance": 1.0, "torque_constant": Kt, "back_emf_constant": 0.0}
    joint = {"motor": motor | {"rotor_inertia": Mm}, "gear": {"ratio": Ng}}
    file = write_scene(tmp_path, make_link_urdf(), {"joint": joint})
    plant = Plant(load_scene(file, {"integrator": {"scheme": scheme, "dt": h}}))
    a = Kt * V / Ng / (LINK_INERTIA + Mm / Ng**2)
    for k in (1, 2, 3, 10):
        plant.reset()
        plant.advance([V], k)
        assert plant.state.v[0] == pytest.approx(k * a * h, rel=1e-12), "many roundings"
        assert plant.state.q[0] == pytest.approx(
            0.5 * a * h**2 * (k**2 + twice * k), rel=1e-12, abs=1e-18
        )


@pytest.mark.slow
@pytest.mark.parametrize("scheme", some(SCHEMES, 1))
@pytest.mark.parametrize("viscous", [0.0, 0.4])
def test_a_sliding_joint_comes_to_rest(tmp_path: Path, scheme: str, viscous: float) -> None:
    """I dv/dt = -Dc - Dl v stops at t = I/Dl ln(1 + Dl v0/Dc), or I v0/Dc, and stays there."""
    dt, v0, Dc = 1e-4, 3.0, 0.7
    friction = {"viscous": viscous, "coulomb": Dc, "breakaway": 2.0 * Dc}
    plant = sliding(tmp_path, scheme, dt, friction)
    if viscous:
        time = LINK_INERTIA / viscous * np.log(1.0 + viscous * v0 / Dc)
        distance = LINK_INERTIA / viscous * (v0 - Dc / viscous * np.log(1.0 + viscous * v0 / Dc))
    else:
        time, distance = LINK_INERTIA * v0 / Dc, LINK_INERTIA * v0**2 / (2.0 * Dc)
    plant.reset(v=[v0])
    while plant.state.v[0] > 0.0:
        plant.advance([0.0], 1)
    # It stops at the end of the step in which it reverses; a first-order scheme is off by about a
    # step more (relative error of dt Dl / (2 I) over the whole time with viscous friction).
    slack = 0.0 if KNOWN[scheme].order > 1 or not viscous else dt * viscous / LINK_INERTIA * time
    late = plant.t - time
    assert -slack - 1e-9 <= late <= dt + slack + 1e-9, f"it comes to rest {late:.2g} s late"
    # Of first order: v0 dt / 2 from the sum over speeds at one end of each step; of second: the
    # step of the reversal, (Dc / I) dt^2.
    bound = 0.6 * v0 * dt if KNOWN[scheme].order == 1 else Dc / LINK_INERTIA * dt**2
    rest = plant.state.q[0]
    assert rest == pytest.approx(distance, abs=bound), "how far it slid [rad]"
    plant.advance([0.0], 100_000)
    assert plant.state.q[0] == rest and plant.state.v[0] == 0.0, "it stays where it came to rest"


@pytest.mark.slow
@pytest.mark.parametrize("scheme", some(SCHEMES, 1))
def test_friction_only_takes_energy(tmp_path: Path, scheme: str) -> None:
    """A thrown chain of four joints with dry friction alone loses energy till all of it is gone."""
    urdf = write_random_chain(np.random.default_rng(7), 4)
    joint = {"friction": {"coulomb": 1.5, "breakaway": 2.5}}
    joints = dict.fromkeys(list_moving_joints(urdf), joint)
    plant = Plant(
        load_scene(
            write_scene(tmp_path, urdf, joints),
            overrides={"integrator.scheme": scheme, "integrator.dt": 1e-5},
        )
    )
    plant.reset(v=[2.0, -1.0, 1.5, -2.0])
    energies = [plant.energy]
    while energies[-1] > 0.0:
        plant.advance(np.zeros(4), 100)
        energies.append(plant.energy)
        assert plant.t < 30.0, f"{plant.energy:.2g} J are left after 30 s"
    # With forces quadratic in v, of 10 N m, a first-order scheme may gain h a^2 ... in a step, far
    # less than friction of 1.5 N m takes.
    gains = np.diff(energies)
    assert np.all(gains < 1e-9 * energies[0]), f"friction gives {gains.max():.2g} J"
    assert not plant.state.v.any(), f"speeds without energy: {plant.state.v}"
