"""The winding of a motor, the limit of its supply, and a joint without a gear."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from machines import MOTOR, make_link_urdf, write_scene

from arm_emulator import Plant, load_scene
from arm_emulator.machine.parts.gears.gear import RigidGear

GEAR = {"ratio": 0.01, "stiffness": 1e4, "damping": 10.0}
VOLTAGE = 10.0


def plant_with(folder: Path, dt: float, motor: Any = MOTOR) -> Plant:
    joint = {"motor": motor, "gear": GEAR, "friction": {"viscous": 0.5}}
    # Motors that differ in numbers only share a library.
    file = write_scene(folder, make_link_urdf(), {"joint": joint}, varied=["joints.*.motor.*"])
    overrides = {"integrator.dt": dt, "servo_period": 1e-2}
    return Plant(load_scene(file, overrides=overrides))


def test_current_rises_as_in_an_rl_circuit(tmp_path: Path) -> None:
    """i = V/R (1 - exp(-t R/L)), with no back-EMF to disturb it."""
    dt, tau = 1e-5, 1e-3
    plant = plant_with(tmp_path, dt, motor={**MOTOR, "back_emf_constant": 0.0})
    for _ in range(20):
        plant.advance([VOLTAGE], 25)
        exact = VOLTAGE * (1.0 - np.exp(-plant.t / tau))
        # Backward Euler lags by at most dt / (2 tau) of t/tau exp(-t/tau) V/R, to first order.
        bound = VOLTAGE * dt / (2 * tau) * (plant.t / tau) * np.exp(-plant.t / tau)
        current = plant.state.current[0]
        assert current == pytest.approx(exact, abs=1.05 * bound + 1e-12), "the circuit's current"
        steps = round(plant.t / dt)
        discrete = VOLTAGE * (1.0 - (1.0 + dt / tau) ** -steps)
        assert current == pytest.approx(discrete, rel=1e-12), "backward Euler's current"


def test_voltage_is_limited_by_the_supply(tmp_path: Path) -> None:
    plants = [plant_with(tmp_path, 1e-4) for _ in range(2)]
    plants[0].advance([48.0], 50)
    plants[1].advance([1e6], 50)
    assert plants[0].state.v == plants[1].state.v, "speeds at the supply's voltage and beyond"


def test_direct_drive_is_a_rigid_gear_of_unit_ratio() -> None:
    scene = load_scene("three_axis", {"joints.elbow.gear": None})
    assert scene.joints[2].gear == RigidGear(ratio=1.0)
