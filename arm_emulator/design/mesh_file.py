"""Meshes of a robot description: where their files are."""

from __future__ import annotations

import os
import sys
import xml.etree.ElementTree as ET
from pathlib import Path
from urllib.parse import unquote, urlparse

from arm_emulator.design.source_packages import source_packages
from arm_emulator.motion.package_folders import installed_package_folders


def find_mesh(name: str, folder: Path) -> Path | None:
    """Return the file of a mesh: beside the description, or in a package of ROS.

    A package is one around `folder`, by its manifest or its folder's name, or one of the shell.
    """
    url = urlparse(name)
    if url.scheme == "file":
        places = [Path(unquote(url.path))]
    elif url.scheme in ("package", "model"):
        inside = unquote(url.netloc + url.path)
        package, _, rest = inside.partition("/")
        around = source_packages(folder).get(package)
        above = [folder.resolve(), *folder.resolve().parents]
        places = [] if around is None else [around / rest]
        places += [place / inside for place in above]
        for key, below in (("AMENT_PREFIX_PATH", "share"), ("ROS_PACKAGE_PATH", "")):
            for root in filter(None, os.environ.get(key, "").split(os.pathsep)):
                places.append(Path(root) / below / inside)
        places += [Path(p) / "cmeel.prefix" / "share" / inside for p in sys.path if p]
    else:
        places = [folder / name]
    return next((place for place in places if place.is_file()), None)


def move_meshes(robot: ET.Element, folder: Path) -> None:
    """Make the meshes of a description found from elsewhere; `folder` is where it lay.

    Packages that every shell finds keep their names; those of this shell alone do not.
    """
    everywhere = [Path(root) for root in installed_package_folders()]
    for mesh in (*robot.iter("mesh"), *robot.iter("texture")):
        name = mesh.get("filename", "")
        url = urlparse(name)
        if url.scheme in ("package", "model"):
            inside = unquote(url.netloc + url.path)
            if any((root / inside).is_file() for root in everywhere):
                continue
            if found := find_mesh(name, folder):
                mesh.set("filename", found.resolve().as_uri())
        elif name and not url.scheme and not Path(name).is_absolute():
            mesh.set("filename", (folder.resolve() / name).as_uri())
