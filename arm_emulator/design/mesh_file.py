"""Meshes of a robot description: where their files are."""

from __future__ import annotations

import os
import re
import sys
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import unquote, urlparse

import numpy as np

from arm_emulator.base.refusal import Refusal
from arm_emulator.machine.chain import Array
from arm_emulator.motion.collisions import Collisions
from arm_emulator.motion.mesh_units import installed_package_folders
from arm_emulator.motion.motion_config import MotionConfig


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


# Packages of ROS in the folders around a file, as in a clone of a maker's repository, are found by
# their `package.xml`, without a sourced shell and whatever their folder is called.
MANIFEST = "package.xml"
MOST_BYTES = 1 << 20  # of a manifest; a larger file has no name
MOST_FOLDERS = 1000  # that are looked at beside each folder above the file

_COMMENT = re.compile(r"<!--.*?-->", re.DOTALL)
_NAME = re.compile(r"<name>\s*([A-Za-z0-9_.-]+)\s*</name>")


def source_packages(folder: Path) -> dict[str, Path]:
    """Return the packages around a folder, by name: those above it, and next to these.

    Of two with the same name the nearer counts.
    """
    found: dict[str, Path] = {}
    folder = folder.resolve()
    for place in (folder, *folder.parents):
        for candidate in (place, *_subfolders(place)):
            name = _package_name(candidate / MANIFEST)
            if name:
                found.setdefault(name, candidate)
    return found


def _subfolders(folder: Path) -> Iterator[Path]:
    try:
        entries = sorted(folder.iterdir())
    except OSError:  # a folder that may be passed through, but not read
        return
    yield from entries[:MOST_FOLDERS]


def _package_name(manifest: Path) -> str:
    """Return the name that a manifest gives; empty without one."""
    try:
        if not manifest.is_file() or manifest.stat().st_size > MOST_BYTES:
            return ""
        text = manifest.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""
    name = _NAME.search(_COMMENT.sub("", text))
    return name[1] if name else ""


_DRAWN = 100  # poses within the limits
_MOST = 0.8  # share of them: shapes that overlap nearly everywhere are not those of the arm


def own_shapes(urdf_xml: str, joint_names: tuple[str, ...]) -> Collisions | None:
    """Return the test of an arm against itself; None: its shapes cannot be read.

    Args:
        urdf_xml: the robot description, with meshes that can be found.
        joint_names: the joints commanded.
    """
    try:
        return Collisions(urdf_xml, joint_names, (), MotionConfig().collision_margin)
    except Refusal:
        return None


def own_collisions(tested: Collisions | None, start: Array) -> tuple[str, str]:
    """Return the parameter `collisions` for an arm, and the reason.

    Args:
        tested: of `own_shapes`.
        start: angles of the joints at the start (N,) [rad or m].
    """
    if tested is None:
        return "off", "the shapes of the description cannot be read"
    if not tested.pairs:
        return "auto", "no parts of the arm can touch each other; stop with obstacles"
    if touching := tested.first(start):
        return "off", f"{touching} touch wherever it could start"
    rng = np.random.default_rng(0)
    share = np.mean([bool(tested.first(tested.drawn(rng))) for _ in range(_DRAWN)])
    if share > _MOST:
        return "off", f"parts of the arm touch in {share:.0%} of its poses"
    return "stop", "before parts of the arm touch each other"
