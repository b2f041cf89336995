"""Data files of joints that exist: motor, gear and friction as published, in `config/joints`.

A file has the section of a joint as scenes have it, under `joints.NAME`, and the voltage for which
its figures hold. The comments beside the figures name their sources, and go into new scenes.
"""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from arm_emulator.base.io.config_files import find_config_folder
from arm_emulator.base.io.yaml_file import read_yaml
from arm_emulator.base.refusal import Refusal
from arm_emulator.base.validation.number import Number
from arm_emulator.base.validation.section import Section
from arm_emulator.machine.scene.joint import Joint, read_joint

_SUPPLY = Number("supply_voltage", "V", above=0.0)
USABLE = 0.45  # of stall torque and no-load speed at a time


@dataclass(frozen=True)
class JointData:
    """A joint that exists.

    Attributes:
        name: of its file.
        supply: voltage of its drive [V].
        joint: its parts.
        text: lines of its section as they stand in a scene, behind those that name its sources.
    """

    name: str
    supply: float
    joint: Joint
    text: tuple[str, ...]

    @property
    def torque(self) -> float:
        """The largest torque that is asked for [N m], at the link."""
        return abs(self.joint.torque_per_command * self._largest)

    @property
    def speed(self) -> float:
        """The largest speed that is asked for [rad/s], of the link."""
        back_emf = float(vars(self.joint.motor)["back_emf_constant"])
        return USABLE * self.supply / back_emf * abs(self.joint.gear.ratio)

    @property
    def _largest(self) -> float:
        """Usable command [V or A]."""
        stall = self.supply
        if self.joint.unit == "A":
            stall /= float(vars(self.joint.motor)["resistance"])
        limit = vars(self.joint.motor).get("current_limit")
        return min(USABLE * stall, math.inf if limit is None else limit)


def list_joint_names() -> list[str]:
    """Return the names of the joints that have a data file."""
    return sorted(file.stem for file in _find_folder().glob("*.yaml"))


def load_joint_data(name: str) -> JointData:
    """Return the joint of a name.

    Raises:
        Refusal: no file has this name.
    """
    if name not in (names := list_joint_names()):
        raise Refusal("new", "--joint", "name a joint with a data file", name, ", ".join(names))
    file = _find_folder() / f"{name}.yaml"
    root = Section(read_yaml(file), file.name)
    supply = root.read_number(_SUPPLY)
    section = root.require_section("joints").require_section(name)
    return JointData(
        name, supply, read_joint(name, "revolute", section, None), _read_section_lines(file)
    )


def choose_joint_data(choices: Sequence[str], joints: Sequence[str]) -> dict[str, JointData]:
    """Return the joints' data by the names of the joints.

    Args:
        choices: NAME for all joints, or JOINT=NAME for one.
        joints: names of the moving joints.

    Raises:
        Refusal: no such joint, no such data, two data for a joint, or joints for different
            supplies.
    """
    of_all, of_joint = list[str](), dict[str, str]()
    for choice in choices:
        joint, sign, name = choice.rpartition("=")
        if sign and joint not in joints:
            rule = "be JOINT=NAME of a moving joint"
            raise Refusal("new", "--joint", rule, choice, ", ".join(joints))
        if joint in of_joint or (of_all and not sign):
            whose = joint or "all joints"
            raise Refusal("new", "--joint", f"be given once for {whose}", " ".join(choices))
        if sign:
            of_joint[joint] = name
        else:
            of_all.append(name)
    named = {joint: name for name in of_all for joint in joints} | of_joint
    data = {name: load_joint_data(name) for name in dict.fromkeys(named.values())}
    supplies = {data_file.supply: data_file.name for data_file in data.values()}
    if len(supplies) > 1:
        actual = ", ".join(f"{name} for {volts:g} V" for volts, name in supplies.items())
        raise Refusal("new", "--joint", "name joints for one supply voltage", actual)
    return {joint: data[name] for joint, name in named.items()}


def _find_folder() -> Path:
    return find_config_folder() / "joints"


def _read_section_lines(file: Path) -> tuple[str, ...]:
    """Return the lines of a joint's section, behind the comments that name its sources."""
    lines = file.read_text(encoding="utf-8").splitlines()
    sources = [f"    {line}" for line in lines if line.startswith("#")]
    begin = next(k for k, line in enumerate(lines) if re.match(r"  \S+:$", line))
    return (*sources, *lines[begin + 1 :])
