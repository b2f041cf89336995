"""The shipped robots: brakes hold them, end stops take a hit at full speed."""

from typing import Any

import numpy as np
import pytest

from arm_emulator import Plant, load_scene


@pytest.mark.parametrize("name", ["ur5", "panda"])
def test_without_power_links_drop_by_less_than_their_wind_up(name: str) -> None:
    scene = load_scene(name)
    plant, zero, dt = Plant(scene), np.zeros(len(scene.joints)), scene.integrator.dt
    plant.powered = False
    plant.advance(zero, round(0.02 / dt))
    assert plant.measured.brake_closed.all(), "closed after their delay"
    caught = plant.state.q
    plant.advance(zero, round(2.0 / dt))
    x = plant.state
    assert (x.omega_m == 0.0).all(), "rotors stand exactly"
    wind_up = np.abs(scene.wind_up(x.gear_torque)).max()
    assert np.abs(x.q - caught).max() < wind_up, f"wind-up {wind_up:g} rad"
    # Bridges are open for the 20 ms that the brakes take: no winding slows the fall.
    assert np.abs(x.q - scene.start).max() < 6e-3, "from where power went"


@pytest.mark.parametrize("name", ["ur5", "panda"])
def test_a_stop_takes_a_hit_at_full_speed(name: str) -> None:
    """That its energy is accounted for is seen in `test_end_stops`."""
    scene = load_scene(name, {"integrator.dt": 2.5e-4})
    plant, V = Plant(scene), np.zeros(len(scene.joints))
    V[0] = scene.largest_commands[0]
    stop: Any = scene.joints[0].extras[0]
    pushed = V[0] * scene.joints[0].torque_per_command / stop.stiffness
    fastest = deepest = 0.0
    for _ in range(2000):
        plant.advance(V, 8)
        fastest = max(fastest, float(plant.state.v[0]))
        deepest = max(deepest, float(plant.state.q[0]) - stop.upper)
    # Deeper than the joint's own torque pushes it at rest, and not as that of a stalled winding.
    assert pushed < deepest < 0.25, f"{deepest} rad deep, {pushed} at rest"
    assert fastest > 3.0, f"{fastest} rad/s"
