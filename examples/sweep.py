"""A sweep of 200 arms with other frictions and payloads: how far a voltage pulse takes each."""

import numpy as np

from arm_emulator import load_scene
from arm_emulator_fleet import Fleet

FRICTION, MASS = "joints.elbow.friction.viscous", "payload.mass"
MACHINE = {"payload": 0, "varied": [FRICTION, MASS]}
PULSE = np.zeros((1000, 3))  # V, a row per servo period
PULSE[:500, 1:] = [6.0, 4.0]


def sweep(scene, friction, mass):
    fleet = Fleet(scene, len(mass), varied={FRICTION: friction, MASS: mass})
    return fleet.run(PULSE, scene.steps_per_period)


def drawn(arms):
    rng = np.random.default_rng(1)
    return rng.uniform(0.3, 3.0, arms), rng.uniform(0.0, 3.0, arms)


if __name__ == "__main__":
    scene = load_scene("three_axis", MACHINE)
    friction, mass = drawn(200)
    moved = sweep(scene, friction, mass)[-1, :, 2] - scene.start[2]
    for name, values in ((FRICTION, friction), (MASS, mass)):
        print(f"correlation with {name}: {np.corrcoef(values, moved)[0, 1]:.3f}")
    print(f"moved {moved.min():.3f} to {moved.max():.3f} rad")
