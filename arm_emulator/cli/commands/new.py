"""Make a scene, with servo and motion control, from a robot description."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from arm_emulator.base.refusal import Refusal
from arm_emulator.cli.command import command


@command()
def new(
    robot: Path,
    /,
    *arguments: Annotated[str, Parameter(metavar="NAME:=VALUE")],
    tool: Annotated[str | None, Parameter(metavar="LINK")] = None,
    joints: Annotated[list[str] | None, Parameter(metavar="JOINT ...")] = None,
    payload: Annotated[float | None, Parameter(metavar="KG")] = None,
    density: Annotated[float, Parameter(metavar="KG/M3")] = 1200.0,
    motor: Annotated[str, Parameter(metavar="KIND")] = "dc",
    out: Annotated[Path | None, Parameter(metavar="FOLDER")] = None,
    force: bool = False,
) -> int:
    """Make a scene from a robot description.

    Args:
        robot: URDF or xacro source.
        arguments: arguments of the xacro source.
        tool: link of the tool (default: chosen).
        joints: moving joints; the others are held (default: chosen).
        payload: mass at the tool (default: none).
        density: density of bodies without inertia in the description.
        motor: kind of all motors, as `motor.kind` in scenes.
        out: folder of the scene's files (default: the robot's name, here).
        force: overwrite existing files.
    """
    from arm_emulator.cli.new import new as make

    given = dict[str, str]()
    for one in arguments:
        name, sign, value = one.partition(":=")
        if not sign or not name:
            raise Refusal("new", "argument", "be NAME:=VALUE", one)
        given[name] = value
    return make(
        robot, out, tool, joints, given, payload=payload, density=density, motor=motor, force=force
    )
