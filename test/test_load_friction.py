"""Friction that grows with the torque of the gear."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from draws import some
from machines import one_link_urdf, write_scene
from stick_slip import RATIO, ROWS, STEPS, Towed, row, scene_of
from test_stribeck import assert_lanes_move_as_single_arms
from test_stribeck import drawn as drawn_stribeck

from emulator_node.plant import Plant
from emulator_node.scene import SCHEMES, load_scene


def drawn(rng: np.random.Generator) -> tuple[dict[str, float], Towed]:
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


@pytest.mark.parametrize(
    ("seed", "side", "scheme"),
    some([(0, "link", "extrapolated"), (1, "rotor", "rosenbrock"), (2, "link", "rosenbrock"),
          (3, "rotor", "extrapolated")], 2),
)  # fmt: skip
def test_sticking_and_slipping_is_of_order_two_where_located(
    tmp_path: Path, seed: int, side: str, scheme: str
) -> None:
    friction, towed = drawn(np.random.default_rng([seed, 41]))
    t = row(towed) * np.arange(1, ROWS + 1)
    truth, stops = towed.positions(t)
    assert stops >= 1, "the mass shall stick and slip"
    file = scene_of(tmp_path, towed, friction, side, scheme=scheme, events="located")
    errors = []
    for steps in STEPS:
        plant = Plant(load_scene(file, {"integrator.dt": row(towed) / steps}))
        plant.reset(v=[towed.speed])
        q = []
        for _ in t:
            plant.advance([0.0], steps)
            q.append(plant.state.q[0] if side == "link" else plant.state.theta_m[0] * RATIO)
        errors.append(float(np.abs(np.array(q) - truth).max()))
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    # What comes next in the error's expansion is some per cent of it.
    assert orders[1:] == pytest.approx(2.0, abs=0.2), errors


def lift(folder: Path, mu: float, scheme: str, dt: float, stiffness: float | None) -> Plant:
    """A level arm of 2 kg at 0.3 m, its motor without losses of its own."""
    gear = {"ratio": 0.02} | ({"stiffness": stiffness, "damping": 3.0} if stiffness else {})
    motor = {"resistance": 1.0, "torque_constant": 0.1, "back_emf_constant": 0.0,
             "rotor_inertia": 1e-4, "friction": {"load": mu}}  # fmt: skip
    file = write_scene(
        folder, one_link_urdf(), {"joint": {"motor": motor, "gear": gear}}, servo_period=1e-3,
        gravity=[0.0, 0.0, -9.81], integrator={"scheme": scheme, "dt": dt}, varied=["joints.*"],
    )  # fmt: skip
    return Plant(load_scene(file))


@pytest.mark.parametrize("elastic", [True, False])
@pytest.mark.parametrize("scheme", some(SCHEMES, 1))
def test_motors_need_what_the_efficiency_says_to_lift_and_to_lower(
    tmp_path: Path, scheme: str, elastic: bool
) -> None:
    """Behind an elastic gear (1 + mu) and (1 - mu) times the weight; behind a rigid one the load is
    what the motor gives, and the weight over (1 - mu) and (1 + mu)."""
    weight = 2.0 * 9.81 * 0.3 * 0.02  # N m at the rotor, of the level arm
    for eta in (0.9, 0.75, 0.6):
        mu = 1.0 / eta - 1.0 if elastic else 1.0 - eta
        most = weight / eta
        least = weight * (2.0 - 1.0 / eta if elastic else 1.0 / (2.0 - eta))
        plant = lift(tmp_path, mu, scheme, 1e-4, 2e4 if elastic else None)
        for torque, way in (
            (1.01 * most, -1.0), (0.99 * most, 0.0), (1.01 * least, 0.0), (0.99 * least, 1.0),
        ):  # fmt: skip
            plant.reset()
            # The weight winds the gear up before the motor takes more or less of it.
            for part in np.linspace(0.0, 1.0, 200):
                plant.advance([-10.0 * (part * torque + (1.0 - part) * weight)], 10)
            before = float(plant.state.theta_m[0])
            plant.advance([-10.0 * torque], 10_000)
            moved = float(plant.state.theta_m[0]) - before
            told = f"eta {eta}: the rotor turns by {moved:.2g} rad under {torque / weight:.3f}"
            # A hundredth of the weight turns it by some rad; held, it yields as the link swings.
            assert abs(moved) < 0.05 if way == 0.0 else moved * way > 0.3, told


def test_lanes_move_as_single_arms(tmp_path: Path) -> None:
    rng = np.random.default_rng(44)
    friction, towed = drawn(rng)
    file = scene_of(tmp_path, towed, friction, "rotor", scheme="rosenbrock")
    assert_lanes_move_as_single_arms(load_scene(file), rng, towed.speed)


@pytest.mark.parametrize("mu", [0.1, 0.5])
def test_a_gear_that_a_step_does_not_resolve_is_followed(tmp_path: Path, mu: float) -> None:
    """Up to a thousand times as stiff as one that is resolved."""
    for stiffness in 10.0 ** np.arange(3.0, 8.0):
        coarse, fine = (
            lift(tmp_path, mu, "rosenbrock", dt, float(stiffness)) for dt in (1e-3, 2e-5)
        )
        rows = 1.5 * np.sin(0.01 * np.arange(1000))[:, None]
        q, truth = coarse.run(rows, 1), fine.run(rows, 50)
        off = np.abs(q - truth).max() / np.abs(truth).max()
        # Stops and starts cost steps: 1 ms of a swing that takes some tenths of a second.
        assert off < 0.02, f"{stiffness:g} N m/rad: off by {off:.2g} of the way"
