"""Kinematics of a scene's machine, which may differ from what its controllers know."""

from arm_emulator.machine.scene.scene import Scene
from arm_emulator.motion.model.kinematics import Kinematics


def find_true_kinematics(scene: Scene, nominal: Kinematics) -> Kinematics:
    """Return the kinematics of a scene's machine, for the joints and the tool of a controller.

    Where bearings give way it is for all joints of the machine.

    Args:
        scene: the machine.
        nominal: of the controller, returned where it is the machine's.
    """
    if scene.true_urdf == nominal.urdf_xml:
        return nominal
    names = tuple(scene.machine_joints) if scene.chain.deflections else nominal.joint_names
    return Kinematics(scene.true_urdf, names, nominal.tool)
