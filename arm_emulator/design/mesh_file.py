"""Meshes of a robot description, and packages of ROS around it: where their files are."""

import os
import re
import sys
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import unquote, urlparse

from arm_emulator.motion.model.mesh_units import list_installed_package_folders


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
        around = find_source_packages(folder).get(package)
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
    everywhere = [Path(root) for root in list_installed_package_folders()]
    for mesh in (*robot.iter("mesh"), *robot.iter("texture")):
        name = mesh.get("filename", "")
        url = urlparse(name)
        if url.scheme in ("package", "model"):
            inside = unquote(url.netloc + url.path)
            if any((root / inside).is_file() for root in everywhere):
                continue
            if path := find_mesh(name, folder):
                mesh.set("filename", path.resolve().as_uri())
        elif name and not url.scheme and not Path(name).is_absolute():
            mesh.set("filename", (folder.resolve() / name).as_uri())


# Packages of ROS in the folders around a file, as in a clone of a maker's repository, are found by
# their `package.xml`. Neither a sourced shell nor the names of their folders matter.
MANIFEST = "package.xml"
MAX_BYTES = 1 << 20  # of a manifest; a larger file has no name
MAX_FOLDERS = 1000  # that are looked at beside each folder above the file

_COMMENT = re.compile(r"<!--.*?-->", re.DOTALL)
_NAME = re.compile(r"<name>\s*([A-Za-z0-9_.-]+)\s*</name>")


def find_source_packages(folder: Path) -> dict[str, Path]:
    """Return the packages around a folder, by name: those above it, and next to these.

    Of two with the same name the nearer counts.
    """
    packages: dict[str, Path] = {}
    folder = folder.resolve()
    for place in (folder, *folder.parents):
        for candidate in (place, *_list_subfolders(place)):
            name = _read_package_name(candidate / MANIFEST)
            if name:
                packages.setdefault(name, candidate)
    return packages


def _list_subfolders(folder: Path) -> Iterator[Path]:
    try:
        entries = sorted(folder.iterdir())
    except OSError:  # a folder that may be passed through, but not read
        return
    yield from entries[:MAX_FOLDERS]


def _read_package_name(manifest: Path) -> str:
    """Return the name that a manifest gives; empty without one."""
    try:
        if not manifest.is_file() or manifest.stat().st_size > MAX_BYTES:
            return ""
        text = manifest.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""
    name = _NAME.search(_COMMENT.sub("", text))
    return name[1] if name else ""
