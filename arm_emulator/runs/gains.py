"""The servo's and the motion controller's parameters of a scene, and whether they fit it."""

from dataclasses import dataclass
from pathlib import Path

from arm_emulator.base.io.config_files import find_beside, find_scene
from arm_emulator.base.refusal import Refusal
from arm_emulator.base.warning import print_warnings
from arm_emulator.machine.scene.scene import Scene
from arm_emulator.motion.model.config import MotionConfig, load_motion_config
from arm_emulator.servo.servo_config import ServoConfig, load_servo_config


@dataclass(frozen=True)
class Gains:
    """Parameters of servo and motion controller."""

    servo: ServoConfig
    motion: MotionConfig


def load_gains(scene: str | Path) -> Gains:
    """Return the gains that belong to a scene, by its name or file.

    Raises:
        Refusal: a file that is missing or not taken.
    """
    if not isinstance(scene, str | Path):
        raise Refusal("load_gains", "scene", "be a name or a file", scene)
    file = find_scene(str(scene))
    return Gains(
        load_servo_config(find_beside(file, "servo")),
        load_motion_config(find_beside(file, "motion")),
    )


def check_fit(scene: Scene, servo: ServoConfig, motion: MotionConfig) -> None:
    """Refuse gains that are those of another scene.

    Raises:
        Refusal: as `check_joints`, or other periods.
    """
    check_servo(scene, servo)
    where = scene.where
    controller_key = "motion_controller.period"
    _check_same(where, "servo.motion_period", servo.motion_period, controller_key, motion.period)


def check_servo(scene: Scene, servo: ServoConfig) -> None:
    """Refuse a servo that is that of another scene.

    Raises:
        Refusal: as `check_joints`, or another period.
    """
    check_joints(scene, servo)
    period = scene.servo_period
    _check_same(scene.where, "servo.period", servo.period, "the scene's servo_period", period)


def check_joints(scene: Scene, servo: ServoConfig) -> None:
    """Refuse a servo of other joints than the scene's, or of other motors, gears or encoders.

    Raises:
        Refusal: a joint too many or too few; a motor that our servo cannot drive or that takes
            another command; a gear that turns the other way; another word length of an absolute
            encoder.
    """
    if sorted(servo.joint_names) != sorted(scene.joint_names):
        rule = "name every moving joint of the scene once"
        actual, valid = ", ".join(servo.joint_names), ", ".join(scene.joint_names)
        raise Refusal(scene.where, "servo.joint_names", rule, actual, valid)
    of_servo = {joint.name: joint for joint in servo.joints}
    for joint in scene.joints:
        taken = of_servo[joint.name]
        if joint.motor is not None and joint.servo_data is None:
            where = f"joints.{joint.name}.motor.kind"
            raise Refusal(scene.where, where, "be one that our servo drives", joint.motor.kind)
        taken.check_command(scene.where, joint.unit)
        bits = 0 if joint.encoder is None else joint.encoder.bits or 0
        if taken.encoder_bits != bits:
            rule = f"be that of the scene's encoder, {bits}"
            where = f"servo.joints.{joint.name}.encoder_bits"
            raise Refusal(scene.where, where, rule, taken.encoder_bits)
        if taken.gear_ratio * joint.gear.ratio < 0.0:
            rule = f"have the sign of the scene's gear.ratio, {joint.gear.ratio:g}"
            where = f"servo.joints.{joint.name}.gear_ratio"
            raise Refusal(scene.where, where, rule, taken.gear_ratio)


def warn_of_gravity(scene: Scene, motion: MotionConfig) -> None:
    """Warn of torques given to the servo for another gravity than the scene's."""
    gravity = (motion.gravity_x, motion.gravity_y, motion.gravity_z)
    real = scene.gravity or (0.0, 0.0, 0.0)
    if motion.gives in ("torque", "full") and gravity != tuple(real):
        print_warnings(
            f"{scene.where}: the motion controller gives torques for a gravity of {gravity} "
            f"m/s2 (gravity_x, _y, _z), but the scene's is {real}"
        )


def _check_same(where: str, key: str, value: float, expected_key: str, expected: float) -> None:
    if round(value * 1e9) != round(expected * 1e9):
        raise Refusal(where, key, f"be {expected_key}, {expected:g} s", f"{value:g} s")
