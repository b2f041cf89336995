"""Calibrations of Universal Robots: what the ROS driver writes, and what the controller holds.

`ur_calibration` of Universal_Robots_ROS2_Driver writes a YAML file with the placements of the six
joints, as `rpy` and `xyz` of a URDF. The first is in the frame `base`; the last joint's
link is the flange (`tool0`). The controller's `calibration.conf` has numbers that are added to
those of Denavit and Hartenberg (denavit_hartenberg.py).
"""

import configparser
import re
from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path

from arm_emulator.base.calibration.denavit_hartenberg import compute_screw, find_dh_frames
from arm_emulator.base.calibration.deviation import Deviation
from arm_emulator.base.calibration.joint_path import JointPath
from arm_emulator.base.calibration.placed_axes import place_axes
from arm_emulator.base.io.text_file import read_text
from arm_emulator.base.refusal import Refusal
from arm_emulator.base.urdf.frames import Frame, make_frame
from arm_emulator.base.validation.number import Number
from arm_emulator.base.validation.section import Section

LINKS = ("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3")
DELTAS = ("delta_theta", "delta_a", "delta_d", "delta_alpha")
STATUS = "calibration_status"  # 2: linearised, the deltas hold; 0 and 1: they do not yet
LINEARISED = 2
MAX_BYTES = 1 << 20
_PLACE = [Number.bound_size(name, "m", 1e5) for name in "xyz"]
_TURN = [Number.bound_size(name, "rad", 10.0) for name in ("roll", "pitch", "yaw")]
_DELTA = Number.bound_size("deltas", "m or rad", 1e5)  # common normals of almost parallel axes


def read_ur_kinematics(root: Section, path: JointPath) -> Mapping[str, Deviation]:
    """Return the deviations of a file with a section `kinematics`.

    Raises:
        Refusal: another form, or an arm of other than six joints.
    """
    section = root.require_section("kinematics")
    _check_joints(path, root.where)
    frame, axes = path.base, []
    for link in LINKS:
        link_section = section.require_section(link)
        frame = frame @ make_frame(
            map(link_section.read_number, _PLACE), map(link_section.read_number, _TURN)
        )
        axes.append(frame)
    if section.has_key("hash"):
        section.read_text("hash")  # by which the driver compares it with the arm
    root.refuse_unread_keys()
    return place_axes(path, axes, frame)


def read_ur_deltas(file: Path, path: JointPath) -> Mapping[str, Deviation]:
    """Return the deviations of a file `calibration.conf`.

    Raises:
        Refusal: another form, an arm of other than six joints, or one not linearised yet.
    """
    _check_joints(path, file.name)
    rows = _read_rows(file)
    frames = find_dh_frames(path)
    flange = frames[-1].inverse @ path.flange
    frame, axes = frames[0], list[Frame]()
    for k, (here, after) in enumerate(pairwise(frames)):
        axes.append(frame)
        theta, a, d, alpha = (rows[name][k] for name in DELTAS)
        frame = (
            frame @ compute_screw(2, theta, d) @ here.inverse @ after @ compute_screw(0, alpha, a)
        )
    return place_axes(path, axes, frame @ flange)


def _read_rows(file: Path) -> Mapping[str, list[float]]:
    """Return the rows of deltas, six numbers each."""
    parser = configparser.ConfigParser(strict=False, interpolation=None)
    try:
        parser.read_string(read_text(file, MAX_BYTES))
    except configparser.Error as error:
        reason = str(error).splitlines()[0]
        raise Refusal(file.name, "file", "be a calibration of the controller", reason) from None
    if not parser.has_section("mounting"):
        sections = ", ".join(parser.sections()) or "none"
        raise Refusal(file.name, "section mounting", "be given", "nothing", sections)
    section = parser["mounting"]
    status = section.get(STATUS, str(LINEARISED)).split("#")[0].split()
    if status[:1] != [str(LINEARISED)]:
        rule = f"be {LINEARISED}, linearised"
        raise Refusal(file.name, STATUS, rule, " ".join(status) or "nothing")
    return {name: _read_row(file.name, name, section.get(name, "")) for name in DELTAS}


def _read_row(where: str, name: str, text: str) -> list[float]:
    match = re.fullmatch(r"\[(.*)\]", text.split("#", maxsplit=1)[0].strip())
    words = match[1].replace(",", " ").split() if match else []
    if len(words) != len(LINKS):
        raise Refusal(where, name, f"be a row of {len(LINKS)} numbers", text or "nothing")
    try:
        row = [float(word) for word in words]
    except ValueError:
        raise Refusal(where, name, "be numbers", text) from None
    return [_DELTA.check_value(where, value, name) for value in row]


def _check_joints(path: JointPath, where: str) -> None:
    kinds = [joint.kind for joint in path.moving]
    if len(kinds) != len(LINKS) or "prismatic" in kinds:
        names = ", ".join(joint.name for joint in path.moving)
        raise Refusal(where, "arm", f"have {len(LINKS)} revolute joints to its flange", names)
