"""Write what a controller manager of ros2_control needs to drive a scene's machine."""

import re
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from arm_emulator.extension.base import Refusal, find_scene
from arm_emulator.extension.commands import SceneName, command, make_servo_data_unit, output
from arm_emulator.extension.compiler import compile_units, name_stem
from arm_emulator.extension.machine import Scene, compile_ahead, load_scene
from arm_emulator_export import control_files


@command(keys="`libraries`, `description`, `controllers`, `update_rate`")
def write_ros2_control_files(
    scene: SceneName = "three_axis",
    /,
    *,
    into: Annotated[Path, Parameter(metavar="FOLDER")] = Path("ros2_control"),
) -> int:
    """Write what a controller manager of ros2_control needs to drive a scene's machine.

    Args:
        into: folder of its libraries, its robot description and the controllers' parameters.
    """
    machine = load_scene(find_scene(scene))
    compiled = str(into.resolve() / name_stem(machine.name))
    description = control_files.describe_control(machine, compiled)
    controllers = control_files.describe_controllers(machine)
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
        output.print_line(str(path))
    facts = {name: path for name, (path, _) in written.items()}
    output.add_facts({"libraries": libraries, **facts})
    output.add_facts({"update_rate": control_files.update_rate(machine)})
    return 0


def compile_drives(scene: str, machine: Scene, into: Path) -> list[Path]:
    """Compile a scene's machine and the servo of its drives; return the libraries.

    Libraries of an earlier state of the scene are removed, so that its name means one machine.
    """
    libraries = compile_ahead(machine, "native", into)
    libraries += compile_units([make_servo_data_unit(scene)], "native", into)
    ours = re.compile(re.escape(name_stem(machine.name)) + r"(-servo)?-[0-9a-f]+\.so")
    for file in into.iterdir():
        if ours.fullmatch(file.name) and file.name not in {library.name for library in libraries}:
            file.unlink()
    return libraries
