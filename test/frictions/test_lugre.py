"""Friction by bristles that bend before they slip."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from draws import some, with_slow
from machines import LINK_INERTIA, make_link_urdf, write_scene
from scipy.integrate import solve_ivp

from arm_emulator import Diverged, Plant, load_scene
from arm_emulator.base.arrays import Array
from arm_emulator.machine.schemes.known import KNOWN, SCHEMES

PERIOD = 1e-2  # s, over which a voltage is held
STEPS = (160, 320, 640, 1280)  # in a period
RATIO = 0.02  # of the rotor's gear
ROTOR = 1e-4  # kg m2
KT = 0.1  # N m/A; 1 ohm and no back EMF
SCHEME = {"link": "rosenbrock", "rotor": "extrapolated"}  # where one is enough
sides = pytest.mark.parametrize("side", ["link", "rotor"])


def sample_bristles(rng: np.random.Generator, side: str) -> dict[str, float]:
    """Bristles that bend by some 1e-3 rad at the link, and by as much of the rotor's way."""
    # Few bits, so that the breakaway torque is the same multiple exactly, which a library is of.
    Dc = int(rng.integers(128, 512)) / 256.0
    bend, Z = float(10 ** rng.uniform(-3.0, -2.3)), 1.0
    if side == "rotor":
        Dc, bend, Z = Dc / 64.0, bend / RATIO, 1.0 / RATIO
    s0 = Dc / bend
    inertia = LINK_INERTIA if side == "link" else ROTOR + LINK_INERTIA * RATIO**2
    return {
        "coulomb": Dc,
        "breakaway": 1.25 * Dc,
        "stribeck": float(rng.uniform(0.05, 0.3)) * Z,
        "bristle_stiffness": s0,
        "bristle_damping": float(rng.uniform(0.2, 0.6) * np.sqrt(s0 * inertia)),
    }


def with_steps(
    folder: Path, lugre: dict[str, float], side: str, steps: int, scheme: str | None = None
) -> Plant:
    """A link without gravity behind a rigid gear: of ratio 1 and a light rotor, or as above."""
    scheme = scheme or SCHEME[side]
    motor: dict[str, Any] = {"resistance": 1.0, "torque_constant": KT, "back_emf_constant": 0.0}
    motor["rotor_inertia"] = 1e-12 if side == "link" else ROTOR
    joint: dict[str, Any] = {"motor": motor, "gear": {"ratio": 1.0 if side == "link" else RATIO}}
    (joint if side == "link" else motor)["lugre"] = lugre
    events = "located" if KNOWN[scheme].locates else "step"
    file = write_scene(
        folder, make_link_urdf(), {"joint": joint}, servo_period=PERIOD, supply_voltage=1e3,
        integrator={"scheme": scheme, "dt": PERIOD / steps, "events": events}, energy_flow=True,
        # one library for all that are drawn
        varied=["joints.*.friction.*", "joints.*.lugre.*"],
    )  # fmt: skip
    return Plant(load_scene(file))


def truth(lugre: dict[str, float], side: str, voltages: Array) -> Array:
    """z, q, v of the link after each row."""
    Dc, Ds, vs, s0, s1 = lugre.values()
    Ng, inertia = (
        (1.0, LINK_INERTIA) if side == "link" else (RATIO, LINK_INERTIA + ROTOR / RATIO**2)
    )

    def rates(_: float, x: Array, V: float) -> list[float]:
        z, _, v = x
        w = v / Ng
        dz = w - s0 * abs(w) * z / (Dc + (Ds - Dc) * np.exp(-((w / vs) ** 2)))
        return [dz, v, (KT * V - s0 * z - s1 * dz) / Ng / inertia]

    x, out = np.zeros(3), []
    for (V,) in voltages:
        x = solve_ivp(rates, (0.0, PERIOD), x, "LSODA", rtol=1e-10, atol=1e-13, args=(V,)).y[:, -1]
        out.append(x)
    return np.array(out)


def pushes(rng: np.random.Generator, lugre: dict[str, float], rows: int = 16) -> Array:
    """Voltages to and fro: some hold, some break away."""
    return lugre["coulomb"] / KT * rng.uniform(-2.0, 2.0, (rows, 1))


@pytest.mark.parametrize(
    ("side", "scheme"),
    with_slow(
        some([*SCHEME.items(), *((side, scheme) for side in SCHEME for scheme in SCHEMES)], 2), 1
    ),
)  # fmt: skip
def test_every_scheme_keeps_its_order(tmp_path: Path, side: str, scheme: str) -> None:
    rng = np.random.default_rng([side == "link", SCHEMES.index(scheme), 61])
    lugre = sample_bristles(rng, side)
    voltages = pushes(rng, lugre)
    expected = truth(lugre, side, voltages)

    def errors_of(scheme: str) -> Array:
        runs = [with_steps(tmp_path, lugre, side, n, scheme).run(voltages, n) for n in STEPS]
        return np.array([np.abs(q[:, 0] - expected[:, 1]).max() for q in runs])

    errors = errors_of(scheme)
    if KNOWN[scheme].order > 2:
        # The law's kink at rest falls anywhere into a step. It leaves an error of h^2 times another
        # number at each step, of the size of what it leaves in the scheme that is extrapolated.
        assert (errors < 2.0 * errors_of("rosenbrock")).all(), errors
    else:
        # The next term of the error's expansion is some per cent of it. Below 1e-11 rad it is the
        # truth's.
        order = np.log2(errors[-2] / errors[-1])
        assert errors[-1] < 1e-11 or order == pytest.approx(KNOWN[scheme].order, abs=0.15), errors
    assert errors[-1] < 0.02 * np.abs(expected[:, 1]).max(), errors


@pytest.mark.slow
@sides
def test_before_it_slides_a_shaft_yields_as_on_a_spring(tmp_path: Path, side: str) -> None:
    """Under a tenth of the breakaway torque by torque / s0, and a bit for what has slipped."""
    rng = np.random.default_rng([62, side == "link"])
    lugre = sample_bristles(rng, side)
    plant = with_steps(tmp_path, lugre, side, 100)
    for share in (0.02, 0.05, 0.1):
        plant.reset()
        torque = share * lugre["coulomb"]
        for part in np.linspace(0.0, 1.0, 201):  # so slowly that it does not swing
            plant.advance([part * torque / KT], 1000)
        plant.advance([torque / KT], 200_000)
        ratio = 1.0 if side == "link" else RATIO
        bend = torque / lugre["bristle_stiffness"] * ratio
        # Of every way w a part |z| / most of z slips.
        assert plant.state.q[0] == pytest.approx(bend, rel=0.01 + share), f"{share} of Dc"
        assert abs(plant.state.v[0]) < 1e-6 * bend / 1e-2, "it rests"
        plant.advance([0.0], 200_000)
        assert abs(plant.state.q[0]) < 0.3 * bend, "it springs back"


def test_it_slides_at_the_speed_that_the_torque_is_that_of(tmp_path: Path) -> None:
    """Steadily, z = g / s0 and the torque is g(w) + Dv w."""
    rng = np.random.default_rng(63)
    lugre = sample_bristles(rng, "link")
    plant = with_steps(tmp_path, lugre, "link", 200)
    plant.set_parameter("joints.joint.friction.viscous", 1.0)
    for w in (0.6, -0.9):
        g = lugre["coulomb"] + (lugre["breakaway"] - lugre["coulomb"]) * np.exp(
            -((w / lugre["stribeck"]) ** 2)
        )
        torque = np.sign(w) * g + 1.0 * w
        plant.reset(v=[w])
        plant.advance([torque / KT], 200_000)
        assert plant.state.v[0] == pytest.approx(w, rel=1e-3), "steady speed"


def test_bristles_too_short_for_a_step_are_followed_or_diverge(tmp_path: Path) -> None:
    """Moved by more than twice their bend in a step they are not resolved: never in silence."""
    rng = np.random.default_rng(66)
    lugre = sample_bristles(rng, "link")
    outcomes = []
    for times in 10.0 ** np.arange(0.0, 4.0, 0.5):
        stiff = lugre | {"bristle_stiffness": lugre["bristle_stiffness"] * float(times)}
        voltages = np.repeat(pushes(rng, lugre, 8), 4, axis=0)
        plant = with_steps(tmp_path, stiff, "link", 10)
        try:
            q = plant.run(voltages, 10)[:, 0]
        except Diverged:
            outcomes.append("diverged")
            continue
        expected = truth(stiff, "link", voltages)[:, 1]
        off = np.abs(q - expected).max() / np.abs(expected).max()
        outcomes.append("followed")
        assert off < 0.1, f"{times:g} times as stiff: a wrong motion in silence, off by {off:.2f}"
    assert set(outcomes) == {"followed", "diverged"}, outcomes
