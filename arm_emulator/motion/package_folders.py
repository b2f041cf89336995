"""Folders of packages with meshes."""

from __future__ import annotations

import os
from pathlib import Path

import pinocchio as pin


def package_folders() -> list[str]:
    """Return the folders of packages with meshes: those of the shell, and beside Pinocchio."""
    found = os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep)
    for prefix in filter(None, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)):
        found.append(str(Path(prefix) / "share"))
    return _existing(found) + installed_package_folders()


def installed_package_folders() -> list[str]:
    """Return the folders of packages beside Pinocchio, which are found from every shell."""
    return _existing([str(folder / "share") for folder in Path(pin.__file__).parents])


def _existing(folders: list[str]) -> list[str]:
    return [folder for folder in folders if folder and Path(folder).is_dir()]
