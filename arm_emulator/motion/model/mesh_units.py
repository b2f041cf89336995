"""Units of meshes, of which COLLADA files name theirs, and the folders of packages with meshes."""

import os
import re
import xml.etree.ElementTree as ET
from pathlib import Path
from urllib.parse import unquote, urlparse

import pinocchio as pin

_HEAD = 1 << 16  # bytes: the unit stands at the file's beginning
_UNIT = re.compile(rb"<unit\b[^>]*\bmeter\s*=\s*[\"']\s*([0-9.eE+-]+)\s*[\"']")
_COLLADA = ".dae"


def read_mesh_unit(file: Path) -> float:
    """Return the unit of a mesh [m]."""
    if file.suffix.lower() != _COLLADA:
        return 1.0
    with file.open("rb") as opened:
        unit_text = _UNIT.search(opened.read(_HEAD))
    try:
        unit = float(unit_text[1]) if unit_text else 1.0
    except ValueError:
        unit = 1.0
    return unit if unit > 0.0 else 1.0


def scale_to_metres(urdf: str) -> str:
    """Return a robot description whose meshes are scaled by their units, as coal takes them."""
    if _COLLADA not in urdf.lower():
        return urdf
    robot, folders = ET.fromstring(urdf), [Path(folder) for folder in list_package_folders()]
    changed = False
    for mesh in robot.iter("mesh"):
        url = urlparse(mesh.get("filename", ""))
        places = [Path(unquote(url.path))]
        if url.scheme in ("package", "model"):
            places = [folder / unquote(url.netloc + url.path) for folder in folders]
        unit = next((read_mesh_unit(file) for file in places if file.is_file()), 1.0)
        if unit != 1.0:
            scale = [unit * float(factor) for factor in mesh.get("scale", "1 1 1").split()]
            mesh.set("scale", " ".join(map(repr, scale)))
            changed = True
    return ET.tostring(robot, encoding="unicode") if changed else urdf


def list_package_folders() -> list[str]:
    """Return the folders of packages with meshes: those of the shell, and next to Pinocchio."""
    folders = os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep)
    for prefix in filter(None, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)):
        folders.append(str(Path(prefix) / "share"))
    return _select_existing(folders) + list_installed_package_folders()


def list_installed_package_folders() -> list[str]:
    """Return the folders of packages next to Pinocchio, which are found from every shell."""
    return _select_existing([str(folder / "share") for folder in Path(pin.__file__).parents])


def _select_existing(folders: list[str]) -> list[str]:
    return [folder for folder in folders if folder and Path(folder).is_dir()]
