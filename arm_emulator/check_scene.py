"""`arm_emulator check-scene`: whether a scene is valid, and what lies beside it."""

from __future__ import annotations

from arm_emulator.gains import check_fit, load_gains, warn_of_gravity
from arm_emulator.servo_loop import warn_of_loops
from emulator_node.scene import load_scene
from motion_controller_node.motion_config import MotionConfig
from words.config_files import find_beside, find_scene
from words.refusal import Refusal


def check_scene(name: str) -> str:
    """Return in one line what is there; gains that are there are held against the scene.

    Raises:
        Refusal: the scene or what lies beside it is not valid, or they do not fit together.
    """
    file = find_scene(name)
    scene = load_scene(file)
    line = f"{scene.where}: valid, {len(scene.joints)} joints: {', '.join(scene.joint_names)}"
    missing = []
    for kind in ("servo", "motion"):
        try:
            line += f"; {kind}: {find_beside(file, kind)}"
        except Refusal as reason:
            missing.append(f"no {kind} parameters: they must {reason.rule}")
    if missing:
        return "; ".join((line, *missing))
    gains = load_gains(file)
    check_fit(scene, gains.servo, gains.motion)
    _check_controller(scene.urdf, scene.joint_names, gains.motion)
    warn_of_loops(scene, gains.servo)
    warn_of_gravity(scene, gains.motion)
    return line


def _check_controller(urdf: str, joint_names: tuple[str, ...], motion: MotionConfig) -> None:
    # Pinocchio, which is slow to import, only where there is a motion controller to check.
    from motion_controller_node.controller import controller_for

    controller_for(urdf, joint_names, motion)
