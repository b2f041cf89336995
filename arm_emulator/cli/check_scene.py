"""`arm_emulator check-scene`: whether a scene is valid, and what lies beside it."""

from __future__ import annotations

import sys

from arm_emulator.analysis.holding import overloads
from arm_emulator.analysis.mode_loops import withheld_modes, withheld_words
from arm_emulator.analysis.scene_warnings import warn_of_scene
from arm_emulator.analysis.servo_loop import warn_of_loops
from arm_emulator.base.config_files import find_beside, find_scene
from arm_emulator.base.refusal import Refusal
from arm_emulator.cli.mode_table import mode_rows, page_table
from arm_emulator.doors.fieldbus.drives import modes
from arm_emulator.machine.scene import load_scene
from arm_emulator.motion.motion_config import MotionConfig
from arm_emulator.runs.gains import check_fit, check_servo, load_gains, warn_of_gravity


def check_scene(name: str) -> str:
    """Return in one line what is there; gains that are there are held against the scene.

    Raises:
        Refusal: the scene or what lies beside it is not valid, or they do not fit together.
    """
    file = find_scene(name)
    scene = load_scene(file)
    line = f"{scene.where}: valid, {len(scene.joints)} joints: {', '.join(scene.joint_names)}"
    if scene.assumed:
        line += f"; bodies assumed: {', '.join(scene.assumed)}"
    for overload in overloads(scene):
        print(f"warning: {scene.where}: {overload}", file=sys.stderr)
    missing = []
    for kind in ("servo", "motion"):
        try:
            line += f"; {kind}: {find_beside(file, kind)}"
        except Refusal as reason:
            missing.append(f"no {kind} parameters: they must {reason.rule}")
    if missing:
        warn_of_scene(scene)
        return "; ".join((line, *missing))
    gains = load_gains(file)
    check_fit(scene, gains.servo, gains.motion)
    _check_controller(scene.urdf, scene.joint_names, gains.motion)
    warn_of_loops(scene, gains.servo)
    for text in withheld_words(scene, withheld_modes(scene, gains.servo, modes())):
        print(f"warning: {text}", file=sys.stderr)
    warn_of_gravity(scene, gains.motion)
    return line


def modes_of(name: str) -> str:
    """Return the eigenvalues of every loop that the drives of a scene can be put into.

    Raises:
        Refusal: the scene or its servo's gains are not valid, do not fit together, or a joint has
            no motor.
    """
    file = find_scene(name)
    scene, servo = load_scene(file), load_gains(file).servo
    check_servo(scene, servo)
    for joint in scene.joints:
        if joint.motor is None:
            rule = "have a motor, to have loops"
            raise Refusal(scene.where, f"joints.{joint.name}", rule, "none")
    return page_table(mode_rows(scene, servo))


def _check_controller(urdf: str, joint_names: tuple[str, ...], motion: MotionConfig) -> None:
    # Pinocchio, which is slow to import, only where there is a motion controller to check.
    from arm_emulator.motion.controller import controller_for

    controller_for(urdf, joint_names, motion)
