"""Robot descriptions as people have them: a URDF, or a xacro source that is expanded first."""

import importlib.util
import json
import math
import re
import signal
import subprocess
import sys
import tempfile
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from pathlib import Path

from arm_emulator.base.io.config_files import ROBOTS
from arm_emulator.base.io.text_file import explain_missing_file
from arm_emulator.base.refusal import Refusal
from arm_emulator.base.urdf.urdf_text import MAX_BYTES, read_urdf
from arm_emulator.design import expand_xacro
from arm_emulator.design.mesh_file import find_source_packages
from arm_emulator.design.sizing import Sized

_XACRO = re.compile(r"<xacro:|\$\{|\$\(")  # as no URDF has it, whatever the file's name is
_COMMENT = re.compile(r"<!--.*?-->", re.DOTALL)
PATIENCE = 30.0  # s, by the clock: for a source that waits, or a machine that is busy


def read_robot_text(file: Path, arguments: Mapping[str, str]) -> str:
    """Return the URDF that a file holds, or that its xacro source expands to.

    Args:
        file: ends in ``.urdf`` or ``.xacro``; some sources of xacro end in ``.urdf``.
        arguments: of the xacro source, its ``<xacro:arg>``.

    Raises:
        Refusal: no such file, another kind of file, or a source that xacro does not expand.
    """
    reason = explain_missing_file(file)
    if reason is not None:
        raise Refusal("new", f"file {file}", "exist", reason)
    if file.suffix not in ROBOTS:
        raise Refusal("new", f"file {file.name}", "be a robot", "another", "*.urdf, *.xacro")
    if file.suffix == ".urdf":
        text = read_urdf(file)
        if not _XACRO.search(_COMMENT.sub("", text)):
            if arguments:
                raise Refusal(file.name, "arguments", "come with a xacro source", list(arguments))
            return text
    return _expand_source(file, arguments)


def _expand_source(file: Path, arguments: Mapping[str, str]) -> str:
    if importlib.util.find_spec("xacro") is None:
        valid = "pip install xacro, or give the output of `xacro FILE > robot.urdf`"
        raise Refusal(file.name, "file", "be a URDF", "a xacro source", valid)
    mappings = [f"{name}:={value}" for name, value in arguments.items()]
    packages = {name: str(folder) for name, folder in find_source_packages(file.parent).items()}
    command = [
        sys.executable, "-P", expand_xacro.__file__, str(file.resolve()), json.dumps(packages),
        *mappings,
    ]  # fmt: skip
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as errors:
        try:
            done = subprocess.run(
                command, stdin=subprocess.DEVNULL, stdout=out, stderr=errors,
                timeout=PATIENCE, check=False,
            )  # fmt: skip
            code = done.returncode
        except subprocess.TimeoutExpired:
            code = -signal.SIGKILL
        for stream in (out, errors):
            stream.seek(0)
        text = out.read(MAX_BYTES + 1)
        reason = " ".join(errors.read(2000).decode(errors="replace").split())
    if code < 0:
        reason = f"more than {expand_xacro.SECONDS} s, or more than it may write"
    elif code == expand_xacro.NO_PACKAGE:
        rule = "name a package whose package.xml is around the file, or one of the shell"
        valid = ", ".join(sorted(packages)) or "a clone with package.xml, or a sourced workspace"
        raise Refusal(file.name, f"$(find {reason})", rule, "none", valid)
    elif code == 0 and len(text) <= MAX_BYTES:
        return text.decode(errors="replace")
    raise Refusal(file.name, "file", "be expandable by xacro", reason or "nothing")


KEYS = ("effort", "velocity")


def read_limits(robot: ET.Element) -> dict[str, dict[str, float | None]]:
    """Return `KEYS` of each joint's limit; None: not given, or no number above 0."""
    limits: dict[str, dict[str, float | None]] = {}
    for joint in robot.findall("joint"):
        limit = joint.find("limit")
        values = {key: math.nan if limit is None else _read_number(limit, key) for key in KEYS}
        limits[joint.get("name", "")] = {
            key: value if 0.0 < value < math.inf else None for key, value in values.items()
        }
    return limits


def _read_number(limit: ET.Element, key: str) -> float:
    """Return a number of a joint's limit, 0 where it is not given, NaN for another text."""
    try:
        return float(limit.get(key, "0"))
    except ValueError:
        return math.nan


def forget_impossible(robot: ET.Element) -> bool:
    """Make efforts and velocities that are below 0, or no numbers, unknown; whether there were."""
    changed = False
    for limit in robot.iter("limit"):
        for key in KEYS:
            if not _read_number(limit, key) >= 0.0:
                limit.set(key, "0")
                changed = True
    return changed


def write_limits(robot: ET.Element, drives: Mapping[str, Sized]) -> None:
    """Put a drive's torque, speed and acceleration into the limit of its joint."""
    for joint in robot.findall("joint"):
        drive = drives.get(joint.get("name", ""))
        if drive is None:
            continue
        limit = joint.find("limit")
        if limit is None:
            limit = ET.SubElement(joint, "limit")
        limit.set("effort", f"{drive.peak_torque:.6g}")
        limit.set("velocity", f"{drive.speed:.6g}")
        if limit.get("acceleration") is None:
            limit.set("acceleration", f"{drive.acceleration:.3g}")
