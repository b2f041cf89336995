"""Write what a controller manager of ros2_control needs to drive a scene's machine."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from arm_emulator.base.config_files import find_scene
from arm_emulator.base.refusal import Refusal
from arm_emulator.cli.command import command
from arm_emulator.cli.commands.servo_header import servo_data_unit
from arm_emulator.cli.options import SceneName
from arm_emulator.cli.output import output
from arm_emulator.design import ros2_control as files
from arm_emulator.machine.plant.compiler import compile_ahead
from arm_emulator.machine.scene.scene import Scene, load_scene
from arm_emulator.toolchain.unit import compile_units, name_stem


@command(keys="`libraries`, `description`, `controllers`, `update_rate`")
def ros2_control(
    scene: SceneName = "three_axis",
    /,
    *,
    into: Annotated[Path, Parameter(metavar="FOLDER")] = Path("ros2_control"),
) -> int:
    """Write what a controller manager of ros2_control needs to drive a scene's machine.

    Args:
        into: folder of its libraries, its robot description and the controllers' parameters.
    """
    output.facts(write_ros2_control(scene, into))
    return 0


def compile_drives(scene: str, machine: Scene, into: Path) -> list[Path]:
    """Compile a scene's machine and the servo of its drives; return the libraries.

    Libraries of an earlier state of the scene are removed, so that its name means one machine.
    """
    libraries = compile_ahead(machine, "native", into)
    libraries += compile_units([servo_data_unit(scene)], "native", into)
    ours = re.compile(re.escape(name_stem(machine.name)) + r"(-servo)?-[0-9a-f]+\.so")
    for file in into.iterdir():
        if ours.fullmatch(file.name) and file.name not in {library.name for library in libraries}:
            file.unlink()
    return libraries


def write_ros2_control(scene: str, into: Path) -> dict[str, Any]:
    """Write the files of `ros2_control`, print their paths, and return them by what they are.

    Raises:
        Refusal: a scene with couplings, without gains, or a folder that cannot be written.
    """
    machine = load_scene(find_scene(scene))
    compiled = str(into.resolve() / name_stem(machine.name))
    description, controllers = files.description(machine, compiled), files.controllers(machine)
    libraries = compile_drives(scene, machine, into)
    written = {
        "description": (into / f"{machine.name}.urdf", description),
        "controllers": (into / f"{machine.name}_controllers.yaml", controllers),
    }
    for path, text in written.values():
        try:
            path.write_text(text, encoding="utf-8")
        except OSError as error:
            raise Refusal("ros2-control", f"file {path}", "be writable", error.strerror) from None
    for path in (*libraries, *(path for path, _ in written.values())):
        output.line(str(path))
    facts = {name: path for name, (path, _) in written.items()}
    return {"libraries": libraries, **facts, "update_rate": files.update_rate(machine)}
