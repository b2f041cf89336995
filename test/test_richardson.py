"""Richardson's extrapolation against its own ingredients; its order: test_schemes.py."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from draws import some
from machines import MOTOR, one_link_urdf, write_scene

from arm_emulator import Plant, Scene, load_scene
from arm_emulator.machine.plant.plant_state import SET

PERIOD, VOLTS = 0.01, 10.0


def linear_joint(folder: Path) -> Path:
    gear = {"ratio": 0.01, "stiffness": 1e4, "damping": 10.0}
    joint = {"motor": MOTOR, "gear": gear, "friction": {"viscous": 0.5}}
    return write_scene(folder, one_link_urdf(), {"joint": joint})


def arm(scheme: str, dt: float, **changes: Any) -> Scene:
    return load_scene(
        "three_axis",
        {"integrator.scheme": scheme, "integrator.dt": dt, "servo_period": 1e-3} | changes,
    )


def test_a_step_is_the_combination_of_its_ingredients() -> None:
    rows = np.random.default_rng(6).uniform(-10.0, 10.0, (20, 3))
    full_step, half, both = (
        Plant(arm(*integrator))
        for integrator in (("rosenbrock", 1e-3), ("rosenbrock", 5e-4), ("richardson", 1e-3))
    )
    for row in rows:
        saved = both.state
        for plant in (full_step, half):
            plant.put("start", {name: getattr(saved, name) for name in SET})
        full_step.advance(row, 1), half.advance(row, 2), both.advance(row, 1)
        for name in SET:
            w, y, combined = (getattr(plant.state, name) for plant in (full_step, half, both))
            size = np.abs(y).max() + 1.0
            np.testing.assert_allclose(combined, y + (y - w) / 3.0, rtol=0.0, atol=1e-13 * size)


def test_at_a_limit_it_is_rosenbrock_with_half_the_step() -> None:
    limited = {"joints.*.motor.current_limit": 0.5, "varied": ["joints.*"]}
    half, both = (
        Plant(arm("rosenbrock", 5e-4, **limited)),
        Plant(arm("richardson", 1e-3, **limited)),
    )
    for _ in range(50):  # all motors at their limits, from the first step on
        half.advance([40.0, -40.0, 40.0], 2), both.advance([40.0, -40.0, 40.0], 1)
        assert np.abs(both.state.current).max() == 0.5
        np.testing.assert_allclose(both.state.q, half.state.q, rtol=0.0, atol=1e-14)


LUGRE = {"coulomb": 2.0, "breakaway": 2.6, "stribeck": 0.2, "bristle_stiffness": 200.0}
NEVER_USUAL: dict[str, dict[str, Any]] = {
    "lugre": {"lugre": LUGRE | {"bristle_damping": 5.0}},
    "dry rotor": {"motor.friction": {"coulomb": 5e-3, "breakaway": 6e-3}},
    "play": {"gear.backlash": 1e-3},
}


@pytest.mark.parametrize("parts", some(NEVER_USUAL, 1))
def test_beside_parts_without_usual_modes_it_is_rosenbrock_with_half_the_step(
    parts: str, tmp_path: Path
) -> None:
    """As its page states; LuGre friction, which has no events, shows the order 2 of that."""
    file = linear_joint(tmp_path)

    def end(scheme: str, steps: int) -> float:
        changes = {f"joints.joint.{key}": value for key, value in NEVER_USUAL[parts].items()}
        integrator = {"integrator.scheme": scheme, "integrator.dt": PERIOD / steps}
        plant = Plant(load_scene(file, {"servo_period": PERIOD} | integrator | changes))
        for volts in (VOLTS, -VOLTS):
            plant.advance([volts], 10 * steps)
        return float(plant.state.q[0])

    assert end("richardson", 50) == pytest.approx(end("rosenbrock", 100), rel=0.0, abs=1e-14)
    if parts == "lugre":
        apart = np.abs(np.diff([end("richardson", steps) for steps in (25, 50, 100, 200)]))
        # The corner at the reversal lies elsewhere in each step.
        assert np.log2(apart[:-1] / apart[1:]) == pytest.approx(2.0, abs=0.3), apart
