"""A scene: one YAML file and one URDF, checked once and frozen.

The machine has no part that the file does not mention. Every refusal states where, which
quantity, which rule, which value.
"""

import math
import os
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from arm_emulator.base.array_equality import ArrayEquality
from arm_emulator.base.arrays import Array
from arm_emulator.base.calibration.calibration import Calibration
from arm_emulator.base.io.config_files import BESIDE, find_config
from arm_emulator.base.io.yaml_file import read_yaml
from arm_emulator.base.name_rule import check_joint_name, check_scene_name
from arm_emulator.base.refusal import Refusal
from arm_emulator.base.saved_objects import SharedObject
from arm_emulator.base.validation.number import Number, list_numbers, number
from arm_emulator.base.validation.section import Section
from arm_emulator.machine.chain import Body, Chain
from arm_emulator.machine.faults.scene_faults import SceneFault
from arm_emulator.machine.parts.frictions.load_friction import LoadFriction
from arm_emulator.machine.parts.measuring.imu import Imu
from arm_emulator.machine.parts.measuring.sensors import SENSOR_PARTS
from arm_emulator.machine.scene.encoder_zeros import put_zeros
from arm_emulator.machine.scene.fault_catalogue import list_faults, list_variable_numbers
from arm_emulator.machine.scene.integrator import Integrator, format_mismatch, suggest_divisors
from arm_emulator.machine.scene.joint import Joint, read_joints
from arm_emulator.machine.scene.overrides import convert_to_plain, override_keys
from arm_emulator.machine.scene.payload import MASS, Load
from arm_emulator.machine.scene.scene_links import SceneLinks
from arm_emulator.machine.schemes.known import LOCATING_SCHEMES
from arm_emulator.machine.varied import Varied, choose_names
from arm_emulator.machine.varied_places import SECTION as CALIBRATION
from arm_emulator.machine.varied_places import vary_places

MASS_NAME = "payload.mass"
LARGEST_SEED = 2**53  # whole numbers up to here are exact

# Meaning of a drive's home offset: from the home position to the zero position, or the reverse.
HOME_OFFSETS = ("home_to_zero", "zero_to_home")

GRAVITY = Number.bound_size("gravity", "m/s2", 1000.0)
CORES = Number("cores", at_least=0, at_most=1023, whole=True)


@dataclass(frozen=True, kw_only=True, eq=False)
class Scene(ArrayEquality, SharedObject):
    """All data of one machine."""

    name: str
    where: str  # the file, for refusals
    urdf: str  # XML text, locked joints fixed: the description that controllers have
    true_urdf: str  # the same with the joints where the machine has them
    calibration: Calibration  # of the machine, by how much both differ
    tool: str  # link whose frame is the tool
    gravity: tuple[float, ...] | None  # m/s2 in the world
    supply_voltage: float = number(
        "V", above=0.0, at_most=1e5, text="no motor gets more, in either direction"
    )
    joints: tuple[Joint, ...]  # that controllers know, base to tool
    chain: Chain  # geometry and inertia of these, and of what their bearings give way
    bare: tuple[Body, ...]  # what the links of the chain are, without the payload
    integrator: Integrator
    servo_period: float = number(
        "s",
        ends=(1e-6, 1.0),
        text="time between two motor states; commands are held that long; a whole number of ns",
    )
    external_wrench: bool  # whether there may be one, see core/mechanics/links/external_wrench.hpp
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
    trusted_inertias: tuple[str, ...] = ()  # links that are not checked for being bodies
    home_offset: str = HOME_OFFSETS[0]  # meaning of object 0x607C of drives on field buses

    def __hash__(self) -> int:
        return hash((self.name, self.urdf, self.servo_period))

    def __repr__(self) -> str:
        return f"<Scene {self.name}: {', '.join(self.joint_names)}>"

    @property
    def has_sensor_errors(self) -> bool:
        """Whether it has sensors with errors."""
        sensors = {part.section for part in SENSOR_PARTS}
        spoiled = any(not sensors.isdisjoint(fault.kind.sections) for fault in self.faults)
        return (
            bool(self.imus) or spoiled or not all(joint.sensors.is_ideal for joint in self.joints)
        )

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the moving joints that controllers know, base to tool."""
        return tuple(joint.name for joint in self.joints)

    @property
    def machine_joints(self) -> dict[str, Joint]:
        """All joints of the machine by name, base to tool: deflections of bearings, too."""
        drives = {
            name: drive for joint in self.joints for name, drive in joint.list_drives().items()
        }
        return {shaft.name: drives[shaft.name] for shaft in self.chain.shafts}

    @property
    def joint_places(self) -> list[int]:
        """Places of the joints that controllers know among the machine's."""
        names = [shaft.name for shaft in self.chain.shafts]
        return [names.index(name) for name in self.joint_names]

    def refuse_bearings(self, user: str) -> None:
        """Refuse bearings that give way, for what cannot take them.

        Raises:
            Refusal: a bearing gives way.
        """
        if self.chain.deflections:
            deflection = f"joints.{self.chain.deflections[0]}"
            raise Refusal(self.where, deflection, f"be absent for {user}", "given")

    @property
    def largest_commands(self) -> Array:
        """The largest command of each joint (N,) [V, N m or A]; inf: it has no limit."""
        return np.array(
            [
                self.supply_voltage
                if joint.motor is None
                else joint.motor.compute_largest_command(self.supply_voltage)
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
        return np.array([joint.gear.compute_wind_up(torque) for joint, torque in pairs])

    @property
    def warnings(self) -> list[str]:
        """Warnings about this scene, one line each."""
        return [*self._warn_of_late_events(), *self._warn_of_loads_of_motors()]

    def _warn_of_late_events(self) -> Iterator[str]:
        now = self.integrator
        sticking = [
            joint.name for joint in self.joints if any(part.can_stick for part in joint.parts)
        ]
        if sticking and now.events != "located" and now.scheme in LOCATING_SCHEMES:
            yield (
                f"{self.where}: integrator.events is step, but joints stick "
                f"({', '.join(sticking)}): when one stops or breaks away is known to one step of "
                f"{now.dt:g} s, and errors there are of first order; located keeps order 2, "
                "`arm_emulator advise` compares the two"
            )

    def _warn_of_loads_of_motors(self) -> Iterator[str]:
        rigid = [joint for joint in self.joints if joint.gear.stiffness is None]
        names = [joint.name for joint in rigid if joint.find_part(LoadFriction) is not None]
        if names:
            yield (
                f"{self.where}: load friction behind a rigid gear ({', '.join(names)}) takes the "
                "motor's torque for the load: it is 0 without a command, and no gear locks itself; "
                "behind an elastic gear (gear.stiffness) the load is that of the teeth"
            )

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
        override_keys(data, dotted, convert_to_plain(value), file.name)
    payload = data.get("payload")
    if isinstance(payload, int | float) and not isinstance(payload, bool):
        data["payload"] = {"mass": payload}
    return _build_scene(Section(data, file.name), file)


def coerce_scene(scene: Scene | str | Path, where: str) -> Scene:
    """Return a scene, loaded if it is given by its name or its file.

    Raises:
        Refusal: as `load_scene`, or it is given by something else.
    """
    if isinstance(scene, Scene):
        return scene
    if not isinstance(scene, str | Path):
        raise Refusal(where, "scene", "be a Scene, a name or a file", scene)
    return load_scene(scene)


def _build_scene(root: Section, file: Path) -> Scene:
    where = file.name
    name = check_scene_name(where, root.read_text("name"))
    links = SceneLinks(root, file)
    chain, mass = links.chain, links.payload_mass
    gravity, numbers = root.read_vector(GRAVITY), root.read_numbers(Scene)
    joints = read_joints(root, chain, links.urdf_file.name, links.limits)
    joints = put_zeros(joints, links.calibration)
    integrator = Integrator.read_section(root.require_section("integrator"))
    dt = suggest_divisors(numbers["servo_period"], integrator.dt, where)
    integrator = replace(integrator, dt=dt)
    unfit = format_mismatch(integrator, numbers["threads"])
    if unfit is not None:
        raise root.make_refusal(*unfit)
    imus = _read_imus(root, chain)
    variable = list_variable_numbers(joints, chain, imus)
    if root.has_key(CALIBRATION):
        variable += vary_places(chain, links.calibration)
    varied = _read_varied(root, variable, mass, numbers["seed"])
    possible: dict[str, SceneFault] = {}
    if root.has_key("faults"):
        names = {number.name for number in varied}
        possible = list_faults(joints, chain, imus, mass, gravity, names)
    rule = "name faults that this scene can have"
    faults = choose_names(root.read_entries("faults"), possible, where, "faults", rule)
    varied += tuple(fault.varied for fault in faults)
    scene = Scene(
        name=name,
        where=where,
        urdf=links.urdf,
        true_urdf=links.true_urdf,
        calibration=links.calibration,
        tool=links.tool,
        gravity=gravity,
        joints=joints,
        chain=chain,
        bare=links.bare,
        integrator=integrator,
        external_wrench=root.is_true("external_wrench"),
        energy_flow=root.is_true("energy_flow"),
        home_offset=root.read_choice("home_offset", HOME_OFFSETS, HOME_OFFSETS[0]),
        cores=_read_cores(root),
        varied=varied,
        load=_read_varied_load(links, varied, faults, where),
        faults=faults,
        possible_faults=tuple(possible.values()),
        imus=imus,
        assumed=_find_links(root, "assumed", links.robot),
        trusted_inertias=_find_links(root, "trusted_inertias", links.robot),
        **numbers,
    )
    for key in BESIDE:
        if root.has_key(key):
            root.read_text(key)
    root.refuse_unread_keys()
    return scene


def _read_varied(
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
        possible.append(Varied(MASS.rename(MASS_NAME), mass))
    if root.has_key("seed") or "seed" in root.read_entries("varied"):
        seed_number = replace(list_numbers(Scene)["seed"], whole=False)  # one is as good as another
        possible.append(Varied(seed_number, seed))
    by_name = {number.name: number for number in possible}
    rule = "name numbers of this scene that can be varied"
    return choose_names(root.read_entries("varied"), by_name, root.where, "varied", rule)


def _read_varied_load(
    links: SceneLinks, varied: Iterable[Varied], faults: Iterable[SceneFault], where: str
) -> Load | None:
    """Return the payload, where numbers or faults change its mass.

    Raises:
        Refusal: they change the link that carries it, too.
    """
    changed = {change.number: fault.name for fault in faults for change in fault.changes}
    changed |= {number.name: number.name for number in varied}
    load = links.make_load() if MASS_NAME in changed else None
    if load is None:
        return None
    link = links.chain.links[load.link].link
    of_link = [by for number, by in sorted(changed.items()) if number.startswith(f"links.{link}.")]
    if of_link:
        rule = f"not change both {MASS_NAME} and numbers of the link that carries it"
        actual = f"{changed[MASS_NAME]} and {of_link[0]}"
        raise Refusal(where, "varied and faults", rule, actual)
    return load


def _find_links(root: Section, key: str, robot: ET.Element) -> tuple[str, ...]:
    """Return the links of the URDF that a list names."""
    names = [link.get("name") for link in robot.findall("link")]
    for name in root.read_entries(key):
        if name not in names:
            raise root.make_refusal(key, "name links of the URDF", name)
    return tuple(map(str, root.read_entries(key)))


def _read_cores(root: Section) -> tuple[int, int]:
    cores = root.read_vector(CORES, size=2)
    if cores is None:
        return -1, -1
    available = os.sched_getaffinity(0)
    if not set(cores) <= available:
        valid = ", ".join(map(str, sorted(available)))
        raise root.make_refusal("cores", "be cores of this machine", list(cores), valid)
    return int(cores[0]), int(cores[1])


def _read_imus(root: Section, chain: Chain) -> tuple[Imu, ...]:
    section = root.get_section("imus")
    if section is None:
        return ()
    for name in section.list_keys():
        check_joint_name(root.where, "name in imus", name)
    return tuple(
        Imu.read_section(name, section.require_section(name), chain) for name in section.list_keys()
    )
