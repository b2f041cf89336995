"""Write a ROS package with which MoveIt moves a scene's arm."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from arm_emulator.extension.base import Refusal, find_config_folder, find_scene
from arm_emulator.extension.commands import SceneName, command, output
from arm_emulator.extension.machine import load_scene
from arm_emulator.extension.runs import load_gains
from arm_emulator_export.commands.ros2_control import compile_drives
from arm_emulator_export.moveit_package import MACHINE, make_package_name, write_moveit_files


@command(keys="`package` (its folder), `libraries`, `files` (paths in it)")
def write_moveit_package(
    scene: SceneName = "ur5",
    /,
    *,
    into: Annotated[Path, Parameter(metavar="FOLDER")] = Path(),
) -> int:
    """Write a ROS package with which MoveIt moves a scene's arm.

    Args:
        into: folder in which the package's folder is made, such as the src/ of a workspace.
    """
    file = find_scene(scene)
    machine, motion = load_scene(file), load_gains(file).motion
    bringup = file.stem if file.parent == find_config_folder() else str(file)
    folder = into / make_package_name(machine)
    texts = write_moveit_files(machine, motion, bringup)
    libraries = compile_drives(scene, machine, folder / MACHINE)
    for name, text in texts.items():
        path = folder / name
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, encoding="utf-8")
        except OSError as error:
            raise Refusal("moveit-config", f"file {path}", "be writable", error.strerror) from None
    for path in (*libraries, *(folder / name for name in texts)):
        output.print_line(str(path))
    output.add_facts({"package": folder, "libraries": libraries, "files": list(texts)})
    return 0
