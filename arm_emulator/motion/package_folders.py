"""Folders of packages with meshes."""

from __future__ import annotations

import os
from pathlib import Path

import pinocchio as pin


def package_folders() -> list[str]:
    """Return the folders of packages with meshes: those of ROS, and beside Pinocchio."""
    found = os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep)
    for prefix in filter(None, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)):
        found.append(str(Path(prefix) / "share"))
    found += [str(folder / "share") for folder in Path(pin.__file__).parents]
    return [folder for folder in found if folder and Path(folder).is_dir()]
