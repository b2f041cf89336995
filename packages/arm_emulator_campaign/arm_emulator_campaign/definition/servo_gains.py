"""Numbers of the servo that a campaign states or draws."""

from __future__ import annotations

from dataclasses import replace

from arm_emulator.extension.base import (
    Refusal,
    Section,
    list_numbers,
)
from arm_emulator.extension.runs import (
    ServoConfig,
    check_rates,
)


def change_gain(servo: ServoConfig, name: str, value: object, where: str) -> ServoConfig:
    """Return a servo with another number, by its name ``controller.joints.JOINT.NUMBER``."""
    *path, key = name.split(".")
    joint = ".".join(path[2:])
    of_joint = next((candidate for candidate in servo.joints if candidate.name == joint), None)
    numbers = {} if of_joint is None else list_numbers(type(of_joint))
    if path[:2] != ["controller", "joints"] or of_joint is None:
        valid = ", ".join(f"controller.joints.{name}" for name in servo.joint_names)
        raise Refusal(where, name, "be a number of the servo", name, valid)
    if key not in numbers:
        raise Refusal(where, name, "be a number of the servo", key, ", ".join(numbers))
    changed = replace(of_joint, **{key: numbers[key].check_value(where, value, name)})
    check_rates(changed, servo.period, f"{where}: controller")
    return replace(
        servo, joints=tuple(changed if joint is of_joint else joint for joint in servo.joints)
    )


def change_gains(servo: ServoConfig, controller: Section, where: str) -> ServoConfig:
    """Return a servo with all numbers that a section of the controller states."""
    joints = controller.get_section("joints")
    for joint in () if joints is None else joints.list_keys():
        section = joints.require_section(joint)  # type: ignore[union-attr]
        for key in section.list_keys():
            name = f"controller.joints.{joint}.{key}"
            servo = change_gain(servo, name, section.read_value(key), where)
    return servo
