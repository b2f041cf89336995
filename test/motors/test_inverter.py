"""The voltage lost in an inverter against closed forms, and the balance of its power."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from balance import balance_of
from draws import with_slow
from machines import DC, GANTRY, PMSM, gantry_urdf, write_scene
from scipy.optimize import brentq

from arm_emulator import Plant, Refusal, load_scene

U, KNEE = 2.0, 0.5
LOSSY: dict[str, Any] = {"inverter": {"voltage_error": U, "knee": KNEE}}
LOOP = {"current_limit": 4.0, "current_loop": {"bandwidth": 300.0}}
COMMAND = np.array([9.0, 7.0, 3.0])


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A winding, one in the frame of its rotor, and one in a current loop; links that stick."""
    motors = (DC | LOSSY, PMSM | LOSSY, DC | LOSSY | LOOP)
    joints = {
        name: {"motor": motor, "gear": {"ratio": 0.01}, "friction": {"coulomb": 1e6}}
        for name, motor in zip(GANTRY, motors, strict=True)
    }
    return write_scene(
        tmp_path_factory.mktemp("gantry"), gantry_urdf(), joints, energy_flow=True,
        varied=["joints.*.friction.coulomb"], integrator={"scheme": "rosenbrock", "dt": 2e-5},
    )  # fmt: skip


def current_at(voltage: float, resistance: float) -> float:
    """Of V = R i + U i / sqrt(i^2 + knee^2)."""
    lost = lambda i: U * i / np.hypot(i, KNEE)  # noqa: E731
    return float(brentq(lambda i: resistance * i + lost(i) - voltage, 0.0, 100.0, xtol=1e-14))


@pytest.mark.parametrize("sign", with_slow([1.0, -1.0], 1))
def test_a_locked_rotor_has_the_current_of_the_remaining_voltage(file: Path, sign: float) -> None:
    plant = Plant(load_scene(file))
    plant.advance(sign * COMMAND, 10_000)  # 0.2 s, 40 time constants and more
    expected = [current_at(9.0, DC["resistance"]), current_at(7.0, PMSM["resistance"]), 3.0]
    # The loop regulates the current with any loss of its inverter.
    assert plant.state.current == pytest.approx(sign * np.array(expected), rel=1e-9)
    i = np.abs(plant.state.current)
    lost = U * i**2 / np.hypot(i, KNEE) * [1.0, 1.5, 1.0]
    copper = np.array([DC["resistance"], 1.5 * PMSM["resistance"], DC["resistance"]]) * i**2
    flow = plant.advance_metered(sign * COMMAND, 500)
    assert flow.dissipated == pytest.approx(0.01 * (copper + lost), rel=1e-9)
    assert flow.supplied == pytest.approx(flow.dissipated, rel=1e-9), "nothing is stored"


def test_the_power_of_motors_that_move_is_balanced(file: Path) -> None:
    rng, left = np.random.default_rng(5), []
    rows = rng.uniform(-1.0, 1.0, (20, 3)) * COMMAND
    for dt in (2e-5, 1e-5):
        plant = Plant(load_scene(file, {"integrator.dt": dt}))
        for name in GANTRY:
            plant.set_parameter(f"joints.{name}.friction.coulomb", 0.0)
        result = balance_of(plant, rows, round(5e-3 / dt))
        left.append(result.left / result.exchanged)
    assert left[0] < 1e-4 and left[1] < 0.3 * left[0], f"{left}"


def test_an_inverter_without_an_inductance_is_refused() -> None:
    with pytest.raises(Refusal, match=r"elbow\.motor\.inverter must belong to a motor that has an"):
        load_scene(
            "three_axis",
            {"joints.elbow.motor": {"kind": "torque", "rotor_inertia": 1e-4, **LOSSY}},
        )
