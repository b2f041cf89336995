"""Friction that falls as a shaft begins to slide."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from draws import some
from machines import LINK_INERTIA, one_link_urdf, write_scene
from scipy.integrate import solve_ivp
from stick_slip import assert_order_two, drawn

from arm_emulator import Plant, load_scene
from arm_emulator.machine.schemes.known import SCHEMES


@pytest.mark.parametrize(
    ("seed", "scheme"),
    some([(0, "rosenbrock"), (1, "extrapolated"), (2, "rosenbrock"), (3, "extrapolated")], 1),
)
def test_sticking_and_slipping_is_of_order_two_where_located(
    tmp_path: Path, seed: int, scheme: str
) -> None:
    friction, towed = drawn(np.random.default_rng([seed, 31]))
    assert_order_two(tmp_path, towed, friction, scheme, stops=2)


@pytest.mark.parametrize("scheme", some(["extrapolated", "implicit", "rosenbrock", "paper"], 1))
def test_a_thrown_link_comes_to_rest_where_the_equation_states(tmp_path: Path, scheme: str) -> None:
    """I dv/dt = -Dv v - sliding(v), to the end of the step in which it stops."""
    rng = np.random.default_rng([SCHEMES.index(scheme), 32])
    friction, towed = drawn(rng)
    v0 = float(rng.uniform(2.0, 6.0)) * friction["stribeck"]

    def rates(_: float, x: np.ndarray) -> list[float]:
        torque = friction["viscous"] * x[1] + towed.sliding(x[1], 0.0)
        return [x[1], -torque / LINK_INERTIA]

    def stopped(_: float, x: np.ndarray) -> float:
        return float(x[1])

    stopped.terminal = True  # type: ignore[attr-defined]
    found = solve_ivp(rates, (0.0, 1e3), [0.0, v0], "DOP853", rtol=1e-12, atol=1e-14,
                      events=stopped)  # fmt: skip
    time, distance = found.t[-1], found.y[0, -1]
    dt = float(f"{time / 3000.0:.3g}")
    file = write_scene(
        tmp_path, one_link_urdf(), {"joint": {"friction": friction}}, servo_period=dt,
        integrator={"scheme": scheme, "dt": dt}, varied=["joints.*"],
    )  # fmt: skip
    plant = Plant(load_scene(file))
    plant.reset(v=[v0])
    while plant.state.v[0] > 0.0:
        plant.advance([0.0], 1)
    # First order is off by about a step's part of the whole.
    assert plant.t == pytest.approx(time, abs=3.0 * dt), "when it comes to rest"
    slack = 2.0 * v0 * dt if scheme in ("implicit", "paper") else 20.0 * v0 * dt * dt / time
    assert plant.state.q[0] == pytest.approx(distance, abs=slack), "how far it slid"
    rest = plant.state.q[0]
    plant.advance([0.0], 10_000)
    assert plant.state.q[0] == rest and plant.state.v[0] == 0.0, "it stays there"
