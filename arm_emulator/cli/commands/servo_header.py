"""Write the data of a scene's joints as a C header for our servo."""

import math
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from arm_emulator.base.escape import escape_c_string
from arm_emulator.base.io.config_files import find_scene
from arm_emulator.base.refusal import Refusal
from arm_emulator.cli.command import command
from arm_emulator.cli.options import SceneName
from arm_emulator.cli.output import output
from arm_emulator.machine.scene.scene import load_scene
from arm_emulator.runs.gains import check_servo, load_gains
from arm_emulator.servo.c import FOLDER
from arm_emulator.servo.servo_config import ServoConfig
from arm_emulator.servo.servo_law import SERVO
from arm_emulator.servo.servo_numbers import make_servo_numbers
from arm_emulator.servo.watchdog import count_nanoseconds
from arm_emulator.toolchain.c_header import Header
from arm_emulator.toolchain.flags import C_FLAGS
from arm_emulator.toolchain.unit import Unit


@command(keys="`scene`, `file`, `header` (null in a file)")
def write_servo_header(
    scene: SceneName = "three_axis",
    /,
    *,
    out: Annotated[Path | None, Parameter(metavar="FILE")] = None,
) -> int:
    """Write the data of a scene's joints as a C header for our servo.

    Args:
        out: header file (default: the terminal).
    """
    file = find_scene(scene)
    machine, servo = load_scene(file), load_gains(file).servo
    check_servo(machine, servo)
    header = write_header(machine.name, machine.joint_names, servo)
    output.add_facts({"scene": machine.name, "file": out, "header": None if out else header})
    if out is None:
        output.print_line(header.removesuffix("\n"))
        return 0
    try:
        if not out.is_file() or out.read_bytes() != header.encode():
            out.write_text(header, encoding="utf-8")
    except OSError as error:
        raise Refusal("servo-header", f"file {out}", "be writable", error.strerror) from None
    return 0


SERVO_DATA = Header(FOLDER / "servo_data.h", (FOLDER,))
_DATA = """\
#include "servo_data.h"
int servo_get_data(servo_data* out) {
  const servo_data data = {sizeof data, SERVO_JOINTS, SERVO_PERIOD, SERVO_SCENE, servo_joints,
                           servo_names};
  if (out) *out = data;
  return out != 0;
}
"""


def make_servo_data_unit(scene: str) -> Unit:
    """Return our servo with the data of a scene's joints as what is compiled.

    Raises:
        Refusal: no gains, or those of another scene.
    """
    file = find_scene(scene)
    machine, servo = load_scene(file), load_gains(file).servo
    check_servo(machine, servo)
    header = write_header(machine.name, machine.joint_names, servo)
    name, about = f"{machine.name}-servo", f"the servo of {machine.name}"
    source = f'#include "servo.c"\n{header}{_DATA}'
    return Unit(name, source, C_FLAGS, (FOLDER,), (SERVO_DATA,), "servo", about, "servo.c")


def write_header(scene_name: str, joint_names: tuple[str, ...], config: ServoConfig) -> str:
    """Return the header: numbers for `servo_joint`, times, names, in an order of joints.

    Raises:
        Refusal: numbers of a data sheet are out of range.
    """
    by_name = {joint.name: joint for joint in config.joints}
    joints = tuple(by_name[name] for name in joint_names)
    rows = make_servo_numbers(joints, config.period, config.supply_voltage).tolist()
    fields = SERVO.get_dtype("servo_joint").names or ()
    names = ", ".join(escape_c_string(name) for name in joint_names)
    bodies = ",\n".join(
        f"    {{{', '.join(_format_field(*pair) for pair in zip(fields, row, strict=True))}}}"
        for row in rows
    )
    times = {
        "PERIOD": config.period,
        "MOTION_PERIOD": config.motion_period,
        "HOLD_AFTER": config.hold_after,
        "CUT_AFTER": config.cut_after,
    }
    defined = "\n".join(
        f"#define SERVO_{name} INT64_C({count_nanoseconds(value)}) /* ns */"
        for name, value in times.items()
    )
    return f"""\
/* Data of a scene's joints for servo.h. `arm_emulator servo-header` writes it. */
#ifndef SERVO_JOINTS_H
#define SERVO_JOINTS_H

#include "servo.h"

#define SERVO_SCENE {escape_c_string(scene_name)}
#define SERVO_JOINTS {len(joints)}
{defined}

static const char* const servo_names[SERVO_JOINTS] = {{{names}}};

static const servo_joint servo_joints[SERVO_JOINTS] = {{
{bodies},
}};

#endif
"""


def _format_field(name: str, value: object) -> str:
    if isinstance(value, tuple):
        return f"\n     .{name} = {{{', '.join(map(_format_number, value))}}}"
    return f"\n     .{name} = {_format_number(value)}"


def _format_number(value: object) -> str:
    if isinstance(value, int):
        return str(value)
    assert isinstance(value, float)
    return repr(value) if math.isfinite(value) else "SERVO_UNLIMITED"
