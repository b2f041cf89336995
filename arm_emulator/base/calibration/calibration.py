"""The calibration of one machine: deviations of its joints, put into its description."""

import copy
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from arm_emulator.base.calibration.denavit_hartenberg import displace_along_axes, find_dh_frames
from arm_emulator.base.calibration.deviation import Deviation
from arm_emulator.base.calibration.joint_path import find_path
from arm_emulator.base.calibration.kuka_files import read_kuka_zeros
from arm_emulator.base.calibration.ur_files import read_ur_deltas, read_ur_kinematics
from arm_emulator.base.io.text_file import explain_missing_file
from arm_emulator.base.io.yaml_file import read_yaml
from arm_emulator.base.refusal import Refusal
from arm_emulator.base.urdf.frames import Frame, compute_rpy
from arm_emulator.base.urdf.joint_tree import (
    MOVING_KINDS,
    UrdfJoint,
    list_element_names,
    parse_joints,
    read_joints,
)
from arm_emulator.base.urdf.urdf_text import parse_urdf
from arm_emulator.base.validation.number import list_numbers
from arm_emulator.base.validation.section import Section

KUKA = ".dat"
SUFFIXES = (".yaml", ".yml", ".conf", KUKA)


@dataclass(frozen=True)
class Calibration:
    """Deviations of the joints of a description, by name.

    Attributes:
        deviations: of moving and of fixed joints.
        base: link in whose frame makers state their numbers; empty: `base`, else the root link.
        flange: link up to which they do; empty: `tool0`, else the tool.
        where: its name in refusals.
    """

    deviations: Mapping[str, Deviation] = field(default_factory=dict)
    base: str = ""
    flange: str = ""
    where: str = "calibration"

    def list_displacements(
        self, robot: ET.Element, tool: str, *, zeros: bool
    ) -> Mapping[str, Frame]:
        """Return the frame to which each joint's is displaced, seen from it, by name.

        Args:
            robot: the description, locked joints fixed.
            tool: the tool's link.
            zeros: whether joints are turned back by `encoder_zero`, so that positions which the
                encoders report place the links; else positions are the joints' own.

        Raises:
            Refusal: a number that the description cannot take.
        """
        joints = _read_joints_by_name(robot, self.where)
        frames = self._displace_axes(robot, tool)
        for name, deviation in self.deviations.items():
            frames[name] = frames.get(name, Frame()) @ deviation.displaced
            if zeros and deviation.encoder_zero:
                back = joints[name].place_at(-deviation.encoder_zero)
                frames[name] = frames[name] @ joints[name].placement.inverse @ back
        return frames

    def _displace_axes(self, robot: ET.Element, tool: str) -> dict[str, Frame]:
        """Return what the numbers of Denavit and Hartenberg do."""
        of_axes = [name for name, deviation in self.deviations.items() if deviation.has_dh_numbers]
        if not of_axes:
            return {}
        path = find_path(robot, self.where, self.base, self.flange, tool)
        moving = [joint.name for joint in path.moving]
        for name in of_axes:
            if name not in moving:
                key = next(key for key in self.deviations[name].nonzero if key.startswith("delta_"))
                rule = "be of a joint that moves the flange"
                raise Refusal(self.where, name_key(name, key), rule, name, ", ".join(moving))
        dh, children = find_dh_frames(path), path.frames
        ends = [*moving, path.behind[0].name] if path.behind else moving
        displacements, before = {}, None
        for name, frame in zip(ends, dh, strict=False):
            deviation = self.deviations.get(name, Deviation()) if name in moving else Deviation()
            displacements[name] = displace_along_axes(deviation, before, frame, children[name])
            before = deviation
        last = self.deviations.get(moving[-1], Deviation())
        if not path.behind and (last.delta_a or last.delta_alpha):
            rule = "be 0 of the last joint, whose own link is the flange"
            key = "delta_a" if last.delta_a else "delta_alpha"
            raise Refusal(self.where, name_key(moving[-1], key), rule, getattr(last, key))
        return displacements


def displace_joints(robot: ET.Element, frames: Mapping[str, Frame], where: str) -> ET.Element:
    """Return a copy of a description with joints displaced to frames seen from their own."""
    displaced = copy.deepcopy(robot)
    elements = [e for e in displaced.findall("joint") if e.get("name") in frames]
    for element, joint in zip(elements, parse_joints(elements, where), strict=True):
        placement = joint.placement @ frames[joint.name]
        for old in element.findall("origin"):
            element.remove(old)
        numbers = placement.p, compute_rpy(placement.R)
        xyz, rpy = (" ".join(map(repr, map(float, row))) for row in numbers)
        ET.SubElement(element, "origin", xyz=xyz, rpy=rpy)
    return displaced


def correct_urdf(urdf_xml: str, file: Path, tool: str) -> str:
    """Return a description with which positions that encoders report place the machine's links.

    Args:
        urdf_xml: the description.
        file: of the machine's calibration.
        tool: the tool's link.

    Raises:
        Refusal: a file that is not taken, or that does not fit to the description.
    """
    robot = parse_urdf(urdf_xml, file.name)
    frames = load_calibration(file, robot, tool).list_displacements(robot, tool, zeros=True)
    return ET.tostring(displace_joints(robot, frames, file.name), encoding="unicode")


def load_calibration(file: Path, robot: ET.Element, tool: str) -> Calibration:
    """Return the calibration in a file: ours, or one of Universal Robots."""
    root = Section({"file": file.name}, file.name)
    return read_calibration(root, robot, tool, file.parent)


def read_calibration(root: Section, robot: ET.Element, tool: str, folder: Path) -> Calibration:
    """Return the calibration of a section.

    Args:
        root: the section, of a scene or a file.
        robot: the description, locked joints fixed.
        tool: the tool's link.
        folder: where relative names of files begin.

    Raises:
        Refusal: a key, a value or a file that is not taken, or no such joint or link.
    """
    base, flange = (_read_link(root, key, robot) for key in ("base", "flange"))
    if root.has_key("nominal") and not root.has_key("file"):
        raise root.make_refusal("nominal", "come with a key file", "alone")
    file, nominal = (_find_file(root, key, folder) for key in ("file", "nominal"))
    deviations = dict[str, Deviation]()
    if file is not None:
        _check_nominal(root, file, nominal)
        of_file = _read_file(file, nominal, base, flange, robot, tool)
        deviations |= of_file.deviations
        base, flange = base or of_file.base, flange or of_file.flange
    section = root.get_section("joints")
    joints = _read_joints_by_name(robot, root.where)
    for name in () if section is None else section.list_keys():
        assert section is not None
        if name not in joints:
            raise section.make_refusal(name, "be a joint of the URDF", name, ", ".join(joints))
        below = section.require_section(name)
        numbers = below.read_numbers(Deviation)
        if numbers["encoder_zero"] and joints[name].kind not in MOVING_KINDS:
            rule = "belong to a joint that moves"
            raise below.make_refusal("encoder_zero", rule, joints[name].kind)
        of_joint = deviations.get(name, Deviation())
        deviations[name] = replace(
            of_joint, **{key: value for key, value in numbers.items() if below.has_key(key)}
        )
    root.refuse_unread_keys()
    return Calibration(deviations, base, flange, root.where)


def name_key(joint: str, key: str) -> str:
    """Return the place of a joint's number in a scene."""
    return f"calibration.joints.{joint}.{key}"


def _read_joints_by_name(robot: ET.Element, where: str) -> dict[str, UrdfJoint]:
    joints = read_joints(robot, list_element_names(robot, "link", where), where)
    return {joint.name: joint for joint in joints}


def _read_link(root: Section, key: str, robot: ET.Element) -> str:
    """Return the name of a link, empty if the key is absent."""
    if not root.has_key(key):
        return ""
    name, links = root.read_text(key), list_element_names(robot, "link", root.where)
    if name not in links:
        raise root.make_refusal(key, "be a link of the URDF", name, ", ".join(links))
    return name


def _find_file(root: Section, key: str, folder: Path) -> Path | None:
    """Return the file that a key names, None if the key is absent."""
    if not root.has_key(key):
        return None
    name = root.read_text(key)
    file = folder / name
    reason = explain_missing_file(file)
    if reason is not None:
        raise root.make_refusal(key, "be a file", f"{name} ({reason})")
    return file


def _check_nominal(root: Section, file: Path, nominal: Path | None) -> None:
    if (file.suffix == KUKA) != (nominal is not None):
        rule = f"be the machine data of the type, beside a file {KUKA} of the machine"
        raise root.make_refusal("nominal", rule, nominal.name if nominal else "nothing")


def _read_file(
    file: Path, nominal: Path | None, base: str, flange: str, robot: ET.Element, tool: str
) -> Calibration:
    """Return the calibration in a file: ours, or a maker's."""
    if file.suffix not in SUFFIXES:
        raise Refusal(file.name, "file", "be a calibration", file.suffix, ", ".join(SUFFIXES))
    root = None
    if file.suffix in (".yaml", ".yml"):
        root = Section(read_yaml(file), file.name)
        if not root.has_key("kinematics"):
            for key in ("file", "nominal"):
                if root.has_key(key):
                    raise root.make_refusal(key, "stand in the scene", repr(root.read_text(key)))
            return read_calibration(root, robot, tool, file.parent)
    path = find_path(robot, file.name, base, flange, tool)
    if root is not None:
        deviations = read_ur_kinematics(root, path)
    elif nominal is not None:
        deviations = read_kuka_zeros(file, nominal, path)
    else:
        deviations = read_ur_deltas(file, path)
    for name, deviation in deviations.items():
        for key, number in list_numbers(Deviation).items():
            number.check_value(file.name, getattr(deviation, key), f"{key} of joint {name}")
    return Calibration(deviations, base, flange, file.name)
