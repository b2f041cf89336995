"""Drag of links, against the closed form of a link that coasts, in either direction."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from machines import GANTRY, MOVED, gantry_urdf, write_scene

from arm_emulator import Plant, Scene, load_scene

DRAG = np.array([0.5, 3.0, 8.0])  # N s2/m2
V = np.array([2.0, -1.5, 3.0])  # m/s
SECONDS, PERIOD = 1.0, 0.05


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The joints of a gantry do not feel each other."""
    joints = {
        name: {"drag": {"coefficient": float(c)}} for name, c in zip(GANTRY, DRAG, strict=True)
    }
    folder = tmp_path_factory.mktemp("drag")
    return write_scene(folder, gantry_urdf(), joints, energy_flow=True, servo_period=PERIOD,
                       integrator={"scheme": "rosenbrock", "dt": PERIOD / 4},
                       varied=["joints.*.drag.coefficient"])  # fmt: skip


def coasted(scene: Scene) -> tuple[np.ndarray, float, float]:
    """Positions at the end, what drag has taken, and how much less energy the links have."""
    plant = Plant(scene)
    plant.reset(np.zeros(3), V)
    before, taken = plant.energy, 0.0
    for _ in range(round(SECONDS / PERIOD)):
        flow = plant.advance_metered(np.zeros(3), scene.steps_per_period)
        taken += float(flow.dissipated.sum())
    return plant.state.q, taken, before - plant.energy


def test_a_link_coasts_as_the_closed_form_with_order_2(file: Path) -> None:
    truth = MOVED / DRAG * np.sign(V) * np.log1p(DRAG * np.abs(V) * SECONDS / MOVED)
    errors, left = [], []
    for steps in (4, 8, 16, 32):
        q, taken, lost = coasted(load_scene(file, {"integrator.dt": PERIOD / steps}))
        errors.append(np.abs(q - truth).max())
        left.append(abs(taken - lost) / lost)
    order = np.log2(np.array(errors[:-1]) / errors[1:])
    assert (order > 1.8).all() and errors[-1] < errors[0] / 50.0, (errors, order)
    assert left[-1] < left[0] / 30.0, "what is left of energy falls with the square of the step"


def test_without_drag_the_link_goes_on(file: Path) -> None:
    """The motion above is the drag's: alone it keeps its speed."""
    q, taken, _ = coasted(load_scene(file, {"joints.*.drag.coefficient": 0.0}))
    np.testing.assert_allclose(q, V * SECONDS, rtol=1e-12)
    assert taken == 0.0
