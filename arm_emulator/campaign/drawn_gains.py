"""Gains of the servo that a campaign states or draws."""

from __future__ import annotations

from dataclasses import replace

from arm_emulator.base.number import numbers_of
from arm_emulator.base.refusal import Refusal
from arm_emulator.base.section import Section
from arm_emulator.servo.servo_config import ServoConfig, check_rates


def with_gain(servo: ServoConfig, name: str, value: object, where: str) -> ServoConfig:
    """Return a servo with another number, by its name ``controller.joints.JOINT.NUMBER``."""
    *path, key = name.split(".")
    joint = ".".join(path[2:])
    of_joint = next((one for one in servo.joints if one.name == joint), None)
    numbers = {} if of_joint is None else numbers_of(type(of_joint))
    if path[:2] != ["controller", "joints"] or of_joint is None:
        valid = ", ".join(f"controller.joints.{one}" for one in servo.joint_names)
        raise Refusal(where, name, "be a number of the servo", name, valid)
    if key not in numbers:
        raise Refusal(where, name, "be a number of the servo", key, ", ".join(numbers))
    changed = replace(of_joint, **{key: numbers[key].take(where, value, name)})
    check_rates(changed, servo.period, f"{where}: controller")
    return replace(servo, joints=tuple(changed if one is of_joint else one for one in servo.joints))


def with_gains(servo: ServoConfig, controller: Section, where: str) -> ServoConfig:
    """Return a servo with all numbers that a section of the controller states."""
    joints = controller.section("joints")
    for joint in () if joints is None else joints.keys():
        section = joints.required_section(joint)  # type: ignore[union-attr]
        for key in section.keys():
            name = f"controller.joints.{joint}.{key}"
            servo = with_gain(servo, name, section.value(key), where)
    return servo
