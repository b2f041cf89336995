"""A scene: one YAML file and one URDF, checked once and frozen.

The machine has no part that the file does not mention. Every refusal states where, which
quantity, which rule, which value.
"""

from __future__ import annotations

import math
import os
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from arm_emulator.base.by_value import ByValue
from arm_emulator.base.config_files import BESIDE, find_config
from arm_emulator.base.number import Number, number, numbers_of
from arm_emulator.base.refusal import Refusal
from arm_emulator.base.saved_objects import Lasting
from arm_emulator.base.section import Section
from arm_emulator.base.shafts import shaft_limits
from arm_emulator.base.urdf_text import limits_of, parse_urdf, read_urdf
from arm_emulator.base.yaml_file import read_yaml
from arm_emulator.machine.chain import Array, Body, Chain
from arm_emulator.machine.faults.scene_faults import SceneFault
from arm_emulator.machine.integrator import Integrator, dividing, odds
from arm_emulator.machine.joint import Joint, read_joints
from arm_emulator.machine.overrides import override, plain
from arm_emulator.machine.parts.imu import Imu
from arm_emulator.machine.parts.sensors import SENSOR_PARTS
from arm_emulator.machine.payload import MASS, Load, load_of, read_payload
from arm_emulator.machine.possible import could_vary, possible_faults
from arm_emulator.machine.schemes.known import LOCATING_SCHEMES
from arm_emulator.machine.urdf_chain import lock_joints, read_chain
from arm_emulator.machine.urdf_file import find_urdf
from arm_emulator.machine.varied import Varied, choose

LONGEST_NAME = 100  # bytes
LARGEST_SEED = 2**53  # whole numbers up to here are exact

GRAVITY = Number.within("gravity", "m/s2", 1000.0)
SHARE = Number("couplings", "", at_least=-1e4, at_most=1e4)
LOCKED = Number("locked", "rad or m", at_least=-1e4, at_most=1e4)
CORES = Number("cores", at_least=0, at_most=1023, whole=True)


@dataclass(frozen=True, kw_only=True, eq=False)
class Scene(ByValue, Lasting):
    """All data of one machine."""

    name: str
    where: str  # the file, for refusals
    urdf: str  # XML text, locked joints fixed
    tool: str  # link whose frame is the tool
    gravity: tuple[float, ...] | None  # m/s2 in the world
    supply_voltage: float = number(
        "V", above=0.0, at_most=1e5, text="no motor gets more, in either direction"
    )
    joints: tuple[Joint, ...]  # base to tool
    chain: Chain  # the same joints' geometry and inertia
    bare: tuple[Body, ...]  # what the links of the chain are, without the payload
    integrator: Integrator
    servo_period: float = number(
        "s",
        ends=(1e-6, 1.0),
        text="time between two motor states; commands are held that long; a whole number of ns",
    )
    external_wrench: bool  # whether there may be one, see core/mechanics/external_wrench.hpp
    energy_flow: (
        bool  # whether what is given and dissipated is reported, see core/mechanics/energy_flow.hpp
    )
    threads: int = number(
        ends=(1, 2),
        whole=True,
        default=1,
        text="2: a motor thread and a Newton-Euler thread, as in the paper; not with every scheme",
    )
    cores: tuple[int, int]  # of the motor thread and the Newton-Euler thread; -1: any
    varied: tuple[Varied, ...]  # numbers that every machine has for itself
    load: Load | None  # the payload, where its mass is varied
    faults: tuple[SceneFault, ...] = ()  # whose magnitudes are the last of the varied numbers
    possible_faults: tuple[SceneFault, ...] = ()  # that it could list, where it lists any
    imus: tuple[Imu, ...]
    seed: int = number(
        ends=(0, LARGEST_SEED), whole=True, default=0, text="of the noise of sensors"
    )
    assumed: tuple[str, ...] = ()  # links whose bodies nobody has measured

    def __hash__(self) -> int:
        return hash((self.name, self.urdf, self.servo_period))

    def __repr__(self) -> str:
        return f"<Scene {self.name}: {', '.join(self.joint_names)}>"

    @property
    def sensed(self) -> bool:
        """Whether it has sensors with errors."""
        sensors = {one.section for one in SENSOR_PARTS}
        spoiled = any(not sensors.isdisjoint(one.kind.sections) for one in self.faults)
        return bool(self.imus) or spoiled or not all(joint.sensors.plain for joint in self.joints)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the moving joints, base to tool."""
        return tuple(joint.name for joint in self.joints)

    @property
    def largest_commands(self) -> Array:
        """The largest command of each joint (N,) [V, N m or A]; inf: it has no limit."""
        return np.array(
            [
                self.supply_voltage
                if joint.motor is None
                else joint.motor.largest_command(self.supply_voltage)
                if joint.unit == "V"
                else joint.motor.command_limit or math.inf
                for joint in self.joints
            ]
        )

    @property
    def gear_ratios(self) -> Array:
        """Turns of the links per turn of their motors (N,); 1 where there is no gear."""
        return np.array([joint.gear.ratio for joint in self.joints])

    @property
    def start(self) -> Array:
        """Joint positions at reset (N,) [rad or m]."""
        return np.array([joint.start for joint in self.joints])

    def wind_up(self, torques: Iterable[float]) -> Array:
        """Return the wind-up of the gears at rest under torques (N,), at the links (N,)."""
        pairs = zip(self.joints, torques, strict=True)
        return np.array([joint.gear.wind_up(torque) for joint, torque in pairs])

    @property
    def warnings(self) -> list[str]:
        """Warnings about this scene, one line each."""
        now = self.integrator
        sticking = [one.name for one in self.joints if any(part.sticks for part in one.parts)]
        if not sticking or now.events == "located" or now.scheme not in LOCATING_SCHEMES:
            return []
        names = ", ".join(sticking)
        return [
            f"{self.where}: integrator.events is step, but joints stick ({names}): "
            f"when one stops or breaks away is known to one step of {now.dt:g} s, and errors there "
            "are of first order; located keeps order 2, `arm_emulator advise` compares the two"
        ]

    @property
    def steps_per_period(self) -> int:
        """Integration steps in one servo period."""
        return round(self.servo_period / self.integrator.dt)


def load_scene(path: str | Path, overrides: Mapping[str, Any] | None = None) -> Scene:
    """Load a scene, checked.

    Args:
        path: a scene file, or the name of a scene that comes with the emulator.
        overrides: values to put in place of the file's, by dotted path, such as
            ``{"integrator.dt": 1e-4, "joints.*.gear.stiffness": None}``; ``*`` is every key there,
            None takes the key out.

    Raises:
        Refusal: the file, its URDF or an override breaks a rule.
    """
    if not isinstance(path, str | Path):
        raise Refusal("load_scene", "scene", "be a name or a file", path)
    file = find_config(str(path), ".yaml")
    data = read_yaml(file)
    if not isinstance(overrides, Mapping | None):
        raise Refusal("load_scene", "overrides", "be values by dotted path", overrides)
    for dotted, value in (overrides or {}).items():
        if not isinstance(dotted, str):
            raise Refusal("load_scene", "path of an override", "be text", repr(dotted))
        override(data, dotted, plain(value), file.name)
    payload = data.get("payload")
    if isinstance(payload, int | float) and not isinstance(payload, bool):
        data["payload"] = {"mass": payload}
    return _build(Section(data, file.name), file)


def scene_of(given: Scene | str | Path, where: str) -> Scene:
    """Return a scene, loaded if it is given by its name or its file.

    Raises:
        Refusal: as `load_scene`, or it is given by something else.
    """
    if isinstance(given, Scene):
        return given
    if not isinstance(given, str | Path):
        raise Refusal(where, "scene", "be a Scene, a name or a file", given)
    return load_scene(given)


def _build(root: Section, file: Path) -> Scene:
    where = file.name
    name = root.text("name", most_bytes=LONGEST_NAME)
    urdf_file = find_urdf(root.text("urdf"), file)
    urdf = read_urdf(urdf_file)
    robot = parse_urdf(urdf, urdf_file.name)
    tool = root.text("tool")
    gravity, numbers = root.vector(GRAVITY), root.numbers(Scene)
    payload = root.section("payload")
    locked_section = root.section("locked")
    locked = {}
    if locked_section is not None:
        locked = {key: locked_section.number(LOCKED.named(key)) for key in locked_section.keys()}
    payload_body = None if payload is None else read_payload(payload)
    _couple(root.section("couplings"), robot)

    def read(load: Body | None) -> Chain:
        return read_chain(robot, urdf_file.name, where, locked=locked, tool=tool, payload=load)

    chain = read(payload_body)
    twice = None if payload_body is None else read(payload_body.scaled(2.0))
    if lock_joints(robot, locked, urdf_file.name) or root.has("couplings"):
        urdf = ET.tostring(robot, encoding="unicode")
    limits = limits_of(robot)
    if not chain.coupling.plain:  # a stop of a shaft is where the first of its joints has one
        of_shafts = shaft_limits(urdf, chain.coupling.shafts)
        limits = {name: of_shafts[name] for name in chain.coupling.apart & of_shafts.keys()}
    joints = read_joints(root, chain, urdf_file.name, limits)
    integrator = Integrator.read(root.required_section("integrator"))
    dt = dividing(numbers["servo_period"], integrator.dt, where)
    integrator = replace(integrator, dt=dt)
    unfit = odds(integrator, numbers["threads"])
    if unfit is not None:
        raise root.refusal(*unfit)
    cores = _cores(root)
    imus = _imus(root, chain)
    mass = None if payload_body is None else payload_body.mass
    varied = _varied(root, could_vary(joints, chain, imus), mass, numbers["seed"])
    possible: dict[str, SceneFault] = {}
    if root.has("faults"):
        possible = possible_faults(joints, chain, imus, mass, gravity)
    rule = "name faults that this scene can have"
    faults = choose(root.entries("faults"), possible, where, "faults", rule)
    varied += tuple(one.varied for one in faults)
    changed = {change.number: one.name for one in faults for change in one.changes}
    changed |= {one.name: one.name for one in varied}
    load = None
    if payload is not None and "payload.mass" in changed:
        load = load_of(*(read(read_payload(payload, mass=kg)) for kg in (1.0, 2.0)))
    if load is not None:
        _check_carrier(chain.links[load.link].link, changed, where)
    external_wrench, energy_flow = root.flag("external_wrench"), root.flag("energy_flow")
    assumed = _links_named(root, "assumed", robot)
    for key in BESIDE:
        if root.has(key):
            root.text(key)
    root.finish()
    return Scene(
        name=name,
        where=where,
        urdf=urdf,
        tool=tool,
        gravity=gravity,
        joints=joints,
        chain=chain,
        bare=_bare(chain, twice),
        integrator=integrator,
        external_wrench=external_wrench,
        energy_flow=energy_flow,
        cores=cores,
        varied=varied,
        load=load,
        faults=faults,
        possible_faults=tuple(possible.values()),
        imus=imus,
        assumed=assumed,
        **numbers,
    )


def _bare(chain: Chain, twice: Chain | None) -> tuple[Body, ...]:
    """Return the bodies of the links without the payload.

    Args:
        chain: with one payload.
        twice: with two; None: the scene has no payload.
    """
    if twice is None:
        return tuple(link.body for link in chain.links)
    # Bodies are linear in the payload: two with one payload, less one with two, have none.
    pairs = zip(chain.links, twice.links, strict=True)
    return tuple(one.body.scaled(2.0) + two.body.scaled(-1.0) for one, two in pairs)


def _varied(
    root: Section, of_parts: list[Varied], mass: float | None, seed: float
) -> tuple[Varied, ...]:
    """Return the numbers that the scene lists as varied.

    Args:
        root: the file.
        of_parts: numbers of joints, links and units that could be.
        mass: of the payload [kg]; None: the scene has no payload.
        seed: of the scene.
    """
    possible = [*of_parts]
    if mass is not None:
        possible.append(Varied(MASS.named("payload.mass"), mass))
    if root.has("seed") or "seed" in root.entries("varied"):
        known = replace(numbers_of(Scene)["seed"], whole=False)  # one is as good as another
        possible.append(Varied(known, seed))
    by_name = {one.name: one for one in possible}
    rule = "name numbers of this scene that can be varied"
    return choose(root.entries("varied"), by_name, root.where, "varied", rule)


def _check_carrier(link: str, changed: Mapping[str, str], where: str) -> None:
    """Refuse to change both the payload and the link that carries it.

    Args:
        link: that carries the payload.
        changed: numbers, and by what: a varied number's name, or a fault's.
        where: the file, for refusals.
    """
    of_link = [by for number, by in sorted(changed.items()) if number.startswith(f"links.{link}.")]
    if of_link:
        rule = "not change both payload.mass and numbers of the link that carries it"
        got = f"{changed['payload.mass']} and {of_link[0]}"
        raise Refusal(where, "varied and faults", rule, got)


def _couple(section: Section | None, robot: ET.Element) -> None:
    """Put the scene's couplings into the joints of its description, where all readers find them."""
    if section is None:
        return
    joints = {joint.get("name", ""): joint for joint in robot.findall("joint")}
    for name in section.keys():
        shares = section.required_section(name)
        if name not in joints:
            raise section.refusal(name, "be a joint of the URDF", name)
        for old in [*joints[name].findall("mimic"), *joints[name].findall("coupling")]:
            joints[name].remove(old)
        for shaft in shares.keys():
            share = shares.number(SHARE.named(shaft))
            ET.SubElement(joints[name], "coupling", joint=shaft, multiplier=repr(share))


def _links_named(root: Section, key: str, robot: ET.Element) -> tuple[str, ...]:
    """Return the links of the URDF that a list names."""
    known = [link.get("name") for link in robot.findall("link")]
    for name in root.entries(key):
        if name not in known:
            raise root.refusal(key, "name links of the URDF", name)
    return tuple(map(str, root.entries(key)))


def _cores(root: Section) -> tuple[int, int]:
    cores = root.vector(CORES, size=2)
    if cores is None:
        return -1, -1
    available = os.sched_getaffinity(0)
    if not set(cores) <= available:
        valid = ", ".join(map(str, sorted(available)))
        raise root.refusal("cores", "be cores of this machine", list(cores), valid)
    return int(cores[0]), int(cores[1])


def _imus(root: Section, chain: Chain) -> tuple[Imu, ...]:
    section = root.section("imus")
    if section is None:
        return ()
    return tuple(Imu.read(name, section.required_section(name), chain) for name in section.keys())
