"""Tables of the parameters of the nodes, as they are declared."""

import dataclasses
from collections.abc import Iterator
from typing import Any

from arm_emulator.base.validation.number import REQUIRED, Number, list_numbers
from arm_emulator.base.validation.parameters import list_parameters
from arm_emulator.motion.model.config import MotionConfig
from arm_emulator.motion.model.drive_parameters import DriveParameters
from arm_emulator.motion.model.input_shaper import ShapedMode
from arm_emulator.servo.servo_config import SETTABLE, JointServo, ServoConfig
from emulator_node.node import EmulatorParameters
from servo_node.node import ServoNodeParameters

Rows = Iterator[list[str]]
HEAD = "| parameter | default | range | meaning |\n|---|---|---|---|"


def write_parameters() -> str:
    """Return a table for each node."""
    motion = _list_numbers(DriveParameters, "joints.NAME.", ())
    modes = _list_numbers(ShapedMode, "modes.NAME.", ())
    joints = _list_numbers(JointServo, "joints.NAME.", SETTABLE)
    of_servo = _list_numbers(ServoConfig, "", SETTABLE)
    nodes = {
        "emulator": _list_parameters(EmulatorParameters),
        "servo": [*_list_parameters(ServoNodeParameters), *of_servo, *joints],
        "motion_controller": [*_list_parameters(MotionConfig), *motion, *modes],
    }
    tables = []
    for node, rows in nodes.items():
        lines = (f"| {' | '.join(row)} |" for row in rows)
        tables.append("\n".join((f"### {node}\n\n{HEAD}", *lines)))
    return "\n\n".join(tables)


def _list_parameters(kind: type[Any]) -> Rows:
    for value in list_parameters(kind).values():
        about, settable = value.metadata, value.metadata["settable"]
        if "number" in about:
            yield _write_number_row(value.name, about["number"], settable)
            continue
        default = _format_code(
            str(value.default).lower() if type(value.default) is bool else str(value.default)
        )
        valid = ("true", "false") if type(value.default) is bool else about["choices"]
        yield _write_row(
            value.name, default, ", ".join(map(_format_code, valid)), about["description"], settable
        )


def _list_numbers(kind: type[Any], prefix: str, settable: tuple[str, ...]) -> Rows:
    numbers = list_numbers(kind)
    for field in dataclasses.fields(kind):
        if field.name in numbers:
            yield _write_number_row(
                prefix + field.name, numbers[field.name], field.name in settable
            )


def _write_number_row(name: str, number: Number, settable: bool) -> list[str]:
    default = (
        "required" if number.default is REQUIRED else f"{number.default:g}".replace("inf", "none")
    )
    return _write_row(name, default, number.range.removeprefix("number "), number.text, settable)


def _write_row(name: str, default: str, valid: str, text: str, settable: bool) -> list[str]:
    return [_format_code(name), default, valid, "* " * settable + text.replace("|", r"\|")]


def _format_code(text: str) -> str:
    return f"`{text}`" if text else "none"
