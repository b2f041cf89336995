"""A sweep of 200 arms with other frictions and payloads: how far a voltage pulse takes each."""

import numpy as np

from arm_emulator import Fleet, load_scene

ARMS, TICKS = 200, 1000
scene = load_scene(
    "three_axis", {"payload": 0, "varied": ["payload.mass", "joints.elbow.friction.viscous"]}
)
rng = np.random.default_rng(1)
friction, mass = rng.uniform(2.0, 6.0, ARMS), rng.uniform(0.0, 3.0, ARMS)
numbers = {"joints.elbow.friction.viscous": friction, "payload.mass": mass}
fleet = Fleet(scene, ARMS, varied=numbers)
voltages = np.zeros((TICKS, 3))
voltages[: TICKS // 2, 2] = 6.0
q = fleet.run(voltages, scene.steps_per_period)
moved = q[-1, :, 2] - scene.start[2]
for name, values in (("friction", friction), ("mass", mass)):
    print(f"correlation with {name}: {np.corrcoef(values, moved)[0, 1]:.3f}")
print(f"moved {moved.min():.3f} to {moved.max():.3f} rad, {len(fleet.diverged)} diverged")
