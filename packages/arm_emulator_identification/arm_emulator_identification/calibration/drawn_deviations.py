"""Deviations of the size that arms have, drawn at random."""

import numpy as np

from arm_emulator.extension.machine import Deviation, UrdfJoint

# Root mean squares over the joints of three UR10, measured by their maker (the tests of
# ur_calibration in Universal_Robots_ROS2_Driver). Each link's frame is as near to the nominal one
# as its axis allows.
LENGTH = 0.29e-3  # m, along each axis
ANGLE = 2.3e-3  # rad, about each axis


def draw_deviations(
    joints: tuple[UrdfJoint, ...], rng: np.random.Generator
) -> dict[str, Deviation]:
    """Return normally distributed deviations of joints, by name."""
    return {
        joint.name: Deviation(
            **dict(zip("xyz", rng.normal(0.0, LENGTH, 3).tolist(), strict=True)),
            **dict(zip(("roll", "pitch", "yaw"), rng.normal(0.0, ANGLE, 3).tolist(), strict=True)),
        )
        for joint in joints
    }
