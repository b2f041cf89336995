"""The links of a scene: its robot description, with couplings, locked joints and the payload."""

import copy
import xml.etree.ElementTree as ET
from pathlib import Path

from arm_emulator.base.calibration.calibration import (
    Calibration,
    displace_joints,
    read_calibration,
)
from arm_emulator.base.urdf.shafts import read_shaft_limits
from arm_emulator.base.urdf.urdf_text import parse_urdf, read_limits, read_urdf
from arm_emulator.base.validation.number import Number
from arm_emulator.base.validation.section import Section
from arm_emulator.machine.chain import Body, Chain
from arm_emulator.machine.scene.bearings import add_bearings
from arm_emulator.machine.scene.payload import Load, load_of, read_payload
from arm_emulator.machine.scene.urdf_chain import lock_joints, read_chain
from arm_emulator.machine.scene.urdf_file import find_urdf

SHARE = Number("couplings", "", at_least=-1e4, at_most=1e4)
LOCKED = Number("locked", "rad or m", at_least=-1e4, at_most=1e4)


class SceneLinks:
    """Result of a scene's keys `urdf`, `tool`, `payload`, `locked`, `couplings` and `calibration`.

    The bearings of its joints that give way are part of the machine's links.

    Attributes:
        urdf_file: the description.
        urdf: its text, locked joints fixed, shares of couplings in it: what controllers know.
        true_urdf: the same with the joints where the machine has them, and its bearings.
        robot: the description, parsed.
        tool: link whose frame is the tool.
        calibration: deviations of the machine from its description.
        chain: geometry and inertia of the machine's moving joints, the payload carried.
        bare: the bodies of the chain's links without the payload.
        limits: ends of the joints' ways by name; of coupled ones those of their shafts.
        payload_mass: [kg]; None: the scene has no payload.

    Args:
        root: the scene file's keys.
        file: the scene file, beside which relative names are searched.

    Raises:
        Refusal: the description or one of the keys breaks a rule.
    """

    def __init__(self, root: Section, file: Path) -> None:
        self.urdf_file = find_urdf(root.read_text("urdf"), file)
        self.urdf = read_urdf(self.urdf_file)
        self.robot = parse_urdf(self.urdf, self.urdf_file.name)
        self.tool, self._where = root.read_text("tool"), file.name
        self._payload = root.get_section("payload")
        locked = root.get_section("locked")
        self._locked = (
            {}
            if locked is None
            else {key: locked.read_number(LOCKED.rename(key)) for key in locked.list_keys()}
        )
        body = None if self._payload is None else read_payload(self._payload)
        self.payload_mass = None if body is None else body.mass
        _apply_coupling(root.get_section("couplings"), self.robot)
        self._true_robot = self.robot
        self.calibration = self._calibrate_robot(root.get_section("calibration"), file)
        joints = root.get_section("joints")
        self._true_robot, self._deflections = add_bearings(
            self._true_robot, joints, self.urdf_file.name
        )
        self.chain = self._read_chain(body)
        twice = None if body is None else self._read_chain(body.scale_mass(2.0))
        self.bare = _remove_payload(self.chain, twice)
        locks = lock_joints(self.robot, self._locked, self.urdf_file.name)
        if locks or root.has_key("couplings"):
            self.urdf = ET.tostring(self.robot, encoding="unicode")
        self.true_urdf = self.urdf
        if self._true_robot is not self.robot:
            lock_joints(self._true_robot, self._locked, self.urdf_file.name)
            self.true_urdf = ET.tostring(self._true_robot, encoding="unicode")
        self.limits = read_limits(self.robot)
        coupling = self.chain.coupling
        if not coupling.is_identity:  # a stop of a shaft is where the first of its joints has one
            of_shafts = read_shaft_limits(self.urdf, coupling.shafts)
            self.limits = {name: of_shafts[name] for name in coupling.apart & of_shafts.keys()}

    def make_load(self) -> Load | None:
        """Return the payload as a function of its mass; None: no joint moves it."""
        assert self._payload is not None
        bodies = [read_payload(self._payload, mass=kg) for kg in (1.0, 2.0)]
        return load_of(*map(self._read_chain, bodies))

    def _calibrate_robot(self, section: Section | None, file: Path) -> Calibration:
        """Read the calibration, and put it into the description of the machine."""
        if section is None:
            return Calibration()
        locked_robot = copy.deepcopy(self.robot)
        lock_joints(locked_robot, self._locked, self.urdf_file.name)
        calibration = read_calibration(section, locked_robot, self.tool, file.parent)
        frames = calibration.list_displacements(locked_robot, self.tool, zeros=False)
        self._true_robot = displace_joints(self.robot, frames, file.name)
        return calibration

    def _read_chain(self, load: Body | None) -> Chain:
        return read_chain(
            self._true_robot,
            self.urdf_file.name,
            self._where,
            locked=self._locked,
            tool=self.tool,
            payload=load,
            deflections=self._deflections,
        )


def _remove_payload(chain: Chain, twice: Chain | None) -> tuple[Body, ...]:
    """Return the bodies of the links without the payload.

    Args:
        chain: with one payload.
        twice: with two; None: the scene has no payload.
    """
    if twice is None:
        return tuple(link.body for link in chain.links)
    # Bodies are linear in the payload: two with one payload, less one with two, have none.
    pairs = zip(chain.links, twice.links, strict=True)
    return tuple(single.body.scale_mass(2.0) + two.body.scale_mass(-1.0) for single, two in pairs)


def _apply_coupling(section: Section | None, robot: ET.Element) -> None:
    """Put the scene's couplings into the joints of its description, where all readers find them."""
    if section is None:
        return
    joints = {joint.get("name", ""): joint for joint in robot.findall("joint")}
    for name in section.list_keys():
        shares = section.require_section(name)
        if name not in joints:
            raise section.make_refusal(name, "be a joint of the URDF", name)
        for old in [*joints[name].findall("mimic"), *joints[name].findall("coupling")]:
            joints[name].remove(old)
        for shaft in shares.list_keys():
            share = shares.read_number(SHARE.rename(shaft))
            ET.SubElement(joints[name], "coupling", joint=shaft, multiplier=repr(share))
