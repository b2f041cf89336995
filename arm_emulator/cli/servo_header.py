"""`arm_emulator servo-header`: data of a scene's joints as a C header for our servo."""

from __future__ import annotations

import math
import sys
from pathlib import Path

from arm_emulator.base.config_files import find_scene
from arm_emulator.base.refusal import Refusal
from arm_emulator.machine.cxx_literals import text
from arm_emulator.machine.scene import load_scene
from arm_emulator.runs.gains import check_servo, load_gains
from arm_emulator.servo.servo_config import ServoConfig
from arm_emulator.servo.servo_law import SERVO
from arm_emulator.servo.servo_numbers import servo_numbers
from arm_emulator.servo.watchdog import nanoseconds


def write_header(scene_name: str, out: Path | None) -> int:
    """Write the header of a scene, its joints base to tool; an identical file is left untouched.

    Raises:
        Refusal: a file that is missing, not taken or cannot be written, or gains that do not fit.
    """
    file = find_scene(scene_name)
    scene, servo = load_scene(file), load_gains(file).servo
    check_servo(scene, servo)
    header = servo_header(scene.name, scene.joint_names, servo)
    if out is None:
        sys.stdout.write(header)
        return 0
    try:
        if not out.exists() or out.read_bytes() != header.encode():
            out.write_text(header, encoding="utf-8")
    except OSError as error:
        raise Refusal("servo-header", f"file {out}", "be writable", error.strerror) from None
    return 0


def servo_header(scene_name: str, joint_names: tuple[str, ...], config: ServoConfig) -> str:
    """Return the header: numbers for `servo_joint`, times, names, in an order of joints.

    Raises:
        Refusal: numbers of a data sheet are out of range.
    """
    known = {joint.name: joint for joint in config.joints}
    joints = tuple(known[name] for name in joint_names)
    rows = servo_numbers(joints, config.period, config.supply_voltage).tolist()
    fields = SERVO.dtype("servo_joint").names or ()
    names = ", ".join(_text(name) for name in joint_names)
    bodies = ",\n".join(
        f"    {{{', '.join(_field(*pair) for pair in zip(fields, row, strict=True))}}}"
        for row in rows
    )
    times = {
        "PERIOD": config.period,
        "MOTION_PERIOD": config.motion_period,
        "HOLD_AFTER": config.hold_after,
        "CUT_AFTER": config.cut_after,
    }
    defined = "\n".join(
        f"#define SERVO_{name} INT64_C({nanoseconds(value)}) /* ns */"
        for name, value in times.items()
    )
    return f"""\
/* Data of a scene's joints for servo.h. `python -m arm_emulator servo-header` writes it. */
#ifndef SERVO_JOINTS_H
#define SERVO_JOINTS_H

#include "servo.h"

#define SERVO_SCENE {_text(scene_name)}
#define SERVO_JOINTS {len(joints)}
{defined}

static const char* const servo_names[SERVO_JOINTS] = {{{names}}};

static const servo_joint servo_joints[SERVO_JOINTS] = {{
{bodies},
}};

#endif
"""


def _text(words: str) -> str:
    plain = words.isascii() and words.isprintable() and not set(words) & set('"\\?')
    return f'"{words}"' if plain else text(words)


def _field(name: str, value: object) -> str:
    if isinstance(value, tuple):
        return f"\n     .{name} = {{{', '.join(map(_number, value))}}}"
    return f"\n     .{name} = {_number(value)}"


def _number(value: object) -> str:
    if isinstance(value, int):
        return str(value)
    assert isinstance(value, float)
    return repr(value) if math.isfinite(value) else "SERVO_UNLIMITED"
