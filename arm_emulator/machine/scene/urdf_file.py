"""The file of a robot description that a scene names."""

import os
import sys
from pathlib import Path

from arm_emulator.base.io.text_file import explain_missing_file
from arm_emulator.base.refusal import Refusal


def find_example_robot_data() -> Path | None:
    """Return the folder of robots of the package example-robot-data, None if not installed."""
    roots = [Path(entry) / "cmeel.prefix" for entry in sys.path if entry]
    roots += map(Path, filter(None, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)))
    for root in roots:
        folder = root / "share" / "example-robot-data" / "robots"
        if folder.is_dir():
            return folder
    return None


def find_urdf(text: str, scene_file: Path) -> Path:
    """Return the file that a scene names: beside it, or in a package.

    Raises:
        Refusal: it does not exist.
    """
    package, colon, rest = text.partition(":")
    if colon and package == "example-robot-data":
        folder = find_example_robot_data()
        if folder is None:
            raise Refusal(
                scene_file.name,
                "urdf",
                "be in the package example-robot-data",
                "no such package",
                "install it with `make robots` or `pip install example-robot-data`",
            )
        inside = os.path.normpath(rest)
        if os.path.isabs(inside) or inside.split(os.sep)[0] == "..":
            rule = "be a file below robots/ of the package example-robot-data"
            raise Refusal(scene_file.name, "urdf", rule, text)
        file = folder / inside
    else:
        file = scene_file.parent / text
    reason = explain_missing_file(file)
    if reason is not None:
        raise Refusal(scene_file.name, "urdf", "be a file", f"{text} ({reason})")
    return file
