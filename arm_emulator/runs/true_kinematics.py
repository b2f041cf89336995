"""Kinematics of a scene's machine, which may differ from what its controllers know."""

from __future__ import annotations

from arm_emulator.machine.scene.scene import Scene
from arm_emulator.motion.model.kinematics import Kinematics


def find_true_kinematics(scene: Scene, known: Kinematics) -> Kinematics:
    """Return the kinematics of a scene's machine, for the joints and the tool of a controller.

    Args:
        scene: the machine.
        known: of the controller, returned where it is the machine's.
    """
    if scene.true_urdf == known.urdf_xml:
        return known
    return Kinematics(scene.true_urdf, known.joint_names, known.tool)
