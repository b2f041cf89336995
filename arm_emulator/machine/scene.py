"""A scene: one YAML file and one URDF, checked once and frozen.

The machine has no part that the file does not mention. Every refusal states where, which
quantity, which rule, which value.
"""

from __future__ import annotations

import math
import os
import sys
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from arm_emulator.base.config_files import BESIDE, find_config
from arm_emulator.base.number import LARGEST, Number, number, numbers_of
from arm_emulator.base.refusal import Refusal
from arm_emulator.base.section import LARGEST_COUNT, Section
from arm_emulator.base.shafts import shaft_limits
from arm_emulator.base.text_file import why_no_file
from arm_emulator.base.urdf_text import limits_of, parse_urdf, read_urdf
from arm_emulator.base.yaml_file import read_yaml
from arm_emulator.machine.chain import Array, Body, Chain
from arm_emulator.machine.faults.scene_faults import SceneFault, faults_of
from arm_emulator.machine.parts.brake import Brake
from arm_emulator.machine.parts.decorator import Decorator
from arm_emulator.machine.parts.encoder import IDEAL_COUNTS_PER_TURN, Encoder
from arm_emulator.machine.parts.end_stops import put_limits
from arm_emulator.machine.parts.friction import Friction, LinkFriction
from arm_emulator.machine.parts.gear import Gear, RigidGear
from arm_emulator.machine.parts.imu import Imu
from arm_emulator.machine.parts.input import VOLTAGE, Input
from arm_emulator.machine.parts.known import (
    LINK_FRICTIONS,
    ROTOR_FRICTIONS,
    read_decorators,
    read_extras,
    read_friction,
    read_gear,
    read_motor,
)
from arm_emulator.machine.parts.motor import Motor, ServoData
from arm_emulator.machine.parts.part import Part
from arm_emulator.machine.parts.sensors import SENSORS, JointSensors
from arm_emulator.machine.parts.torque_motor import TorqueMotor
from arm_emulator.machine.urdf_chain import lock_joints, read_chain
from arm_emulator.machine.urdf_tree import check_inertia
from arm_emulator.machine.varied import Varied, choose
from arm_emulator.machine.varied_body import varied_body

# Of the error between events; the first scheme is the default.
ORDERS = {"rosenbrock": 2, "extrapolated": 2, "implicit": 1, "paper": 1}
SCHEMES = tuple(ORDERS)
EXCHANGES = ("predict", "lag")
DEEPEST_EXCHANGE = 4
EVENTS = ("step", "located")
LOCATING_SCHEMES = tuple(scheme for scheme, order in ORDERS.items() if order > 1)
LARGEST_SEED = 2**53  # whole numbers up to here are exact

_GRAVITY = Number.within("gravity", "m/s2", 1000.0)
_SHARE = Number("couplings", "", at_least=-1e4, at_most=1e4)
_LOCKED = Number("locked", "rad or m", at_least=-1e4, at_most=1e4)
_CORES = Number("cores", at_least=0, at_most=1023, whole=True)
_MASS = Number("mass", "kg", at_least=0.0)  # of the payload
_COM = Number.within("com", "m", 100.0)
_INERTIA = Number.within("inertia", "kg m2", 1e6)


Kind = TypeVar("Kind", bound=Part)


@dataclass(frozen=True)
class Load:
    """A payload whose mass is varied: the link that carries it, and what it adds to that link."""

    link: int
    bare: Body  # the link without it
    per_kg: Body  # what 1 kg more adds


@dataclass(frozen=True, kw_only=True)
class Joint:
    """Section of one moving joint in a scene. A joint without a motor swings freely."""

    name: str
    start: float = number("rad or m", at_least=-1e4, at_most=1e4, default=0.0)
    motor: Motor | None
    gear: Gear
    sensors: JointSensors
    friction: Friction
    rotor_friction: Friction | None = None
    decorators: tuple[Decorator, ...] = ()  # around its motor, innermost first
    brake: Brake | None = None
    extras: tuple[Part, ...] = ()  # that stand in sections of their own

    @property
    def parts(self) -> tuple[Part, ...]:
        """All parts of its drive."""
        motor = () if self.motor is None else (self.motor,)
        rotor = () if self.rotor_friction is None else (self.rotor_friction,)
        brake = () if self.brake is None else (self.brake,)
        of_motor = (*motor, *self.decorators)
        return (*of_motor, self.gear, self.friction, *rotor, *brake, *self.extras)

    def find(self, kind: type[Kind]) -> Kind | None:
        """Return its part of a kind, None if it has none."""
        return next((part for part in self.parts if isinstance(part, kind)), None)

    def torque_driven(self) -> Joint:
        """Return the joint with a motor that gives what torque it is commanded, all else kept.

        Parts between a voltage or a current and the torque of the windings are left out.
        """
        if self.motor is None or self.inputs == TorqueMotor.inputs:
            return self
        motor = TorqueMotor(rotor_inertia=self.motor.inertia)
        kept = tuple(one for one in self.decorators if not one.electrical)
        return replace(self, motor=motor, decorators=kept)

    @property
    def inputs(self) -> tuple[Input, ...]:
        """Inputs of its motor: the command first, then further ones."""
        of_motor = self.motor.inputs if self.motor else (VOLTAGE,)
        return next((one.inputs for one in self.decorators[::-1] if one.inputs), of_motor)

    @property
    def unit(self) -> str:
        """Unit of its command: V, N m or A."""
        return self.inputs[0].unit

    @property
    def current_bandwidth(self) -> float:
        """Bandwidth of its drive's current loop [Hz]; 0: it has none."""
        if self.motor is None:
            return 0.0
        return max((one.bandwidth_around(self.motor) for one in self.decorators), default=0.0)

    @property
    def servo_data(self) -> ServoData | None:
        """Data of motor and drive for a servo; None: ours cannot drive them."""
        data = None if self.motor is None else self.motor.servo_data
        if data is None or self.current_bandwidth == 0.0:
            return data
        return replace(data, current_bandwidth=self.current_bandwidth)

    @property
    def torque_per_command(self) -> float:
        """Torque of the link at rest for a unit of command, of its sign; 0 without a motor."""
        if self.motor is None:
            return 0.0
        return self.motor.torque_per_command * self._of_motor_per_command / self.gear.ratio

    def largest_command(self, supply_voltage: float) -> float | None:
        """Return what its drive can be commanded in either direction; None: anything.

        Args:
            supply_voltage: of the scene [V].
        """
        largest = 0.0 if self.motor is None else self.motor.largest_command(supply_voltage)
        return None if largest is None else largest / self._of_motor_per_command

    @property
    def _of_motor_per_command(self) -> float:
        """Command of the motor itself at rest, per unit of the joint's command."""
        if self.motor is None:
            return 1.0
        return math.prod(one.inner_per_command(self.motor) for one in self.decorators)

    @property
    def encoder(self) -> Encoder | None:
        """Of its motor."""
        return self.sensors.encoder

    @property
    def counts_per_turn(self) -> int:
        """Counts of the encoder in a turn of the motor; without one, of the finest there is."""
        return self.encoder.counts_per_turn if self.encoder else IDEAL_COUNTS_PER_TURN


@dataclass(frozen=True, kw_only=True)
class Integrator:
    """Scheme and step [s]."""

    scheme: str
    dt: float = number("s", at_least=1e-9, at_most=1.0)
    exchange: str  # between two threads, see core/schemes/two_threads.hpp
    # Samples from which a step takes the links' part of two threads.
    exchange_depth: int = number(at_least=1, at_most=DEEPEST_EXCHANGE, whole=True, default=1)
    events: str  # where modes of joints change, see core/schemes/located.hpp


@dataclass(frozen=True, kw_only=True)
class Scene:
    """All data of one machine."""

    name: str
    where: str  # the file, for refusals
    urdf: str  # XML text, locked joints fixed
    tool: str  # link whose frame is the tool
    gravity: tuple[float, ...] | None  # m/s2 in the world
    supply_voltage: float = number("V", above=0.0, at_most=1e5)
    joints: tuple[Joint, ...]  # base to tool
    chain: Chain  # the same joints' geometry and inertia
    bare: tuple[Body, ...]  # what the links of the chain are, without the payload
    integrator: Integrator
    servo_period: float = number("s", at_least=1e-6, at_most=1.0)
    external_wrench: bool  # whether there may be one, see core/mechanics/external_wrench.hpp
    energy_flow: (
        bool  # whether what is given and dissipated is reported, see core/mechanics/energy_flow.hpp
    )
    threads: int = number(at_least=1, at_most=2, whole=True, default=1)
    cores: tuple[int, int]  # of the motor thread and the Newton-Euler thread; -1: any
    varied: tuple[Varied, ...]  # numbers that every machine has for itself
    load: Load | None  # the payload, where its mass is varied
    faults: tuple[SceneFault, ...] = ()  # whose magnitudes are the last of the varied numbers
    possible_faults: tuple[SceneFault, ...] = ()  # that it could list, where it lists any
    imus: tuple[Imu, ...]
    # Of the noise of sensors.
    seed: int = number(at_least=0, at_most=LARGEST_SEED, whole=True, default=0)
    assumed: tuple[str, ...] = ()  # links whose bodies nobody has measured

    def __repr__(self) -> str:
        return f"<Scene {self.name}: {', '.join(self.joint_names)}>"

    @property
    def sensed(self) -> bool:
        """Whether there are sensors that do not report what is there as it is."""
        sensors = {one.section for one in SENSORS}
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
        """Return by how much the gears give way at rest under torques (N,), at the links (N,)."""
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
    file = find_config(str(path), ".yaml")
    data = read_yaml(file)
    if not isinstance(overrides, Mapping | None):
        raise Refusal("load_scene", "overrides", "be values by dotted path", overrides)
    for dotted, value in (overrides or {}).items():
        if not isinstance(dotted, str):
            raise Refusal("load_scene", "path of an override", "be text", repr(dotted))
        override(data, dotted, _plain(value), file.name)
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
    name = root.text("name", most_bytes=100)
    urdf_file = _find_urdf(root.text("urdf"), file)
    urdf = read_urdf(urdf_file)
    robot = parse_urdf(urdf, urdf_file.name)
    tool = root.text("tool")
    gravity, numbers = root.vector(_GRAVITY), root.numbers(Scene)
    payload = root.section("payload")
    locked_section = root.section("locked")
    locked = {}
    if locked_section is not None:
        locked = {key: locked_section.number(_LOCKED.named(key)) for key in locked_section.keys()}
    payload_body = None if payload is None else _payload(payload)
    _couple(root.section("couplings"), robot)

    def read(load: Body | None) -> Chain:
        return read_chain(robot, urdf_file.name, where, locked=locked, tool=tool, payload=load)

    chain = read(payload_body)
    bare = tuple(link.body for link in chain.links)
    if payload_body is not None:
        # Bodies are linear in the payload: two with one payload, less one with two, have none.
        twice = (link.body for link in read(payload_body.scaled(2.0)).links)
        bare = tuple(
            one.scaled(2.0) + two.scaled(-1.0) for one, two in zip(bare, twice, strict=True)
        )
    if lock_joints(robot, locked, urdf_file.name) or root.has("couplings"):
        urdf = ET.tostring(robot, encoding="unicode")
    limits = limits_of(robot)
    if not chain.coupling.plain:  # a stop of a shaft is where the first of its joints has one
        of_shafts = shaft_limits(urdf, chain.coupling.shafts)
        limits = {name: of_shafts[name] for name in chain.coupling.apart & of_shafts.keys()}
    joints = _joints(root, chain, urdf_file.name, limits)
    integrator_section = root.required_section("integrator")
    integrator = Integrator(
        scheme=integrator_section.choice("scheme", SCHEMES, default=SCHEMES[0]),
        exchange=integrator_section.choice("exchange", EXCHANGES, default=EXCHANGES[0]),
        events=integrator_section.choice("events", EVENTS, default=EVENTS[0]),
        **integrator_section.numbers(Integrator),
    )
    dt = _dividing(numbers["servo_period"], integrator.dt, where)
    integrator = replace(integrator, dt=dt)
    unfit = odds(integrator, numbers["threads"])
    if unfit is not None:
        raise root.refusal(*unfit)
    cores = _cores(root)
    imus = _imus(root, chain)
    possible = could_vary(joints, chain, imus)
    if payload_body is not None:
        possible.append(Varied(_MASS.named("payload.mass"), payload_body.mass))
    if root.has("seed") or "seed" in root.entries("varied"):
        seed = replace(numbers_of(Scene)["seed"], whole=False)  # one is as good as another
        possible.append(Varied(seed, numbers["seed"]))
    by_name = {one.name: one for one in possible}
    rule = "name numbers of this scene that can be varied"
    varied = choose(root.entries("varied"), by_name, where, "varied", rule)
    possible_faults: dict[str, SceneFault] = {}
    if root.has("faults"):
        mass = None if payload_body is None else payload_body.mass
        possible_faults = _possible_faults(joints, chain, imus, mass)
    rule = "name faults that this scene can have"
    faults = choose(root.entries("faults"), possible_faults, where, "faults", rule)
    varied += tuple(one.varied for one in faults)
    changed = {change.number for one in faults for change in one.changes}
    changed |= {one.name for one in varied}
    load = None
    if payload is not None and "payload.mass" in changed:
        load = _load(*(read(_payload(payload, mass=kg)) for kg in (1.0, 2.0)))
    if load is not None:
        carrier = f"links.{chain.links[load.link].link}."
        for number in sorted(changed):
            if number.startswith(carrier):
                rule = "not name both payload.mass and numbers of the link that carries it"
                raise Refusal(where, "varied", rule, number)
    for key in ("external_wrench", "imus", "varied", "faults") if not chain.coupling.plain else ():
        if root.has(key):
            rule = "be absent from a scene with couplings or mimic joints"
            raise root.refusal(key, rule, "given")
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
        bare=bare,
        integrator=integrator,
        external_wrench=external_wrench,
        energy_flow=energy_flow,
        cores=cores,
        varied=varied,
        load=load,
        faults=faults,
        possible_faults=tuple(possible_faults.values()),
        imus=imus,
        assumed=assumed,
        **numbers,
    )


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
            share = shares.number(_SHARE.named(shaft))
            ET.SubElement(joints[name], "coupling", joint=shaft, multiplier=repr(share))


def _links_named(root: Section, key: str, robot: ET.Element) -> tuple[str, ...]:
    """Return the links of the URDF that a list names."""
    known = [link.get("name") for link in robot.findall("link")]
    for name in root.entries(key):
        if name not in known:
            raise root.refusal(key, "name links of the URDF", name)
    return tuple(map(str, root.entries(key)))


def odds(integrator: Integrator, threads: int) -> tuple[str, str, object, str] | None:
    """Return what of an integrator does not go together: key, rule, value, what would be valid."""
    scheme = integrator.scheme
    if threads == 2 and scheme == "rosenbrock":
        rule = "be 1 with scheme rosenbrock, whose second stage waits for its first"
        return "threads", rule, 2, "2 with another scheme"
    if integrator.events != "located":
        return None
    if scheme not in LOCATING_SCHEMES:
        rule = f"be step with scheme {scheme}, of first order at any event"
        valid = f"step, or located with scheme {' or '.join(LOCATING_SCHEMES)}"
    elif threads == 2:
        rule = "be step with 2 threads, whose links come from an earlier sample"
        valid = "step, or located with threads: 1"
    else:
        return None
    return "integrator.events", rule, "located", valid


def _cores(root: Section) -> tuple[int, int]:
    cores = root.vector(_CORES, size=2)
    if cores is None:
        return -1, -1
    available = os.sched_getaffinity(0)
    if not set(cores) <= available:
        valid = ", ".join(map(str, sorted(available)))
        raise root.refusal("cores", "be cores of this machine", list(cores), valid)
    return int(cores[0]), int(cores[1])


def _joints(
    root: Section, chain: Chain, urdf_name: str, limits: Mapping[str, tuple[float, float]]
) -> tuple[Joint, ...]:
    section = root.required_section("joints")
    names = {joint.name: joint.kind for joint in chain.joints}
    for key in section.keys():
        if key not in names:
            raise Refusal(
                root.where,
                f"joints.{key}",
                f"be a moving joint of {urdf_name}",
                key,
                ", ".join(names),
            )
    joints = []
    for name, kind in names.items():
        one = section.section(name)
        if one is None:
            raise Refusal(
                root.where,
                f"joints.{name}",
                f"be given, {urdf_name} moves it",
                "nothing",
                "a section, or its position under `locked`",
            )
        joints.append(_joint(name, kind, one, limits.get(name)))
    return tuple(joints)


def _joint(name: str, kind: str, one: Section, limits: tuple[float, float] | None) -> Joint:
    motor, gear, friction = one.section("motor"), one.section("gear"), one.section("friction")
    of_rotor = None if motor is None else motor.section("friction")
    brake, stops = one.section("brake"), one.section("end_stops")
    for key, part in (("gear", gear), ("brake", brake)):
        if motor is None and part is not None:
            raise one.refusal(key, "belong to a joint with a motor", "no motor section")
    if stops is not None:
        put_limits(stops, limits)
    driven = None if motor is None else read_motor(motor)
    joint = Joint(
        name=name,
        **one.numbers(Joint),
        motor=driven,
        gear=RigidGear(ratio=1.0) if gear is None else read_gear(gear),
        sensors=JointSensors.read(one, kind),
        friction=LinkFriction() if friction is None else read_friction(friction, LINK_FRICTIONS),
        rotor_friction=None if of_rotor is None else read_friction(of_rotor, ROTOR_FRICTIONS),
        decorators=read_decorators(driven, motor) if driven and motor else (),
        brake=None if brake is None else Brake.read(brake),
        extras=read_extras(one),
    )
    one.finish()
    if joint.motor is not None:
        for decorator in joint.decorators:
            decorator.check_motor(joint.motor, one)
        _check_reflected(joint.motor, joint.gear.ratio, one)
    return joint


def _check_reflected(motor: Motor, ratio: float, one: Section) -> None:
    """Refuse a gear that makes of sound numbers unsound ones at the link."""
    for what, value in motor.felt_at_link(ratio).items():
        if value > LARGEST:
            rule = f"make the {what} at the link at most {LARGEST:g}"
            raise one.refusal("gear.ratio", rule, f"{value:.3g} with {ratio:g}")


def _payload(section: Section, mass: float | None = None) -> Body:
    """Return the payload in the frame of the tool; `mass` takes the place of the scene's."""
    given = section.number(_MASS)
    mass = given if mass is None else mass
    com = section.vector(_COM) or (0.0, 0.0, 0.0)
    entries = section.vector(_INERTIA, size=6)
    inertia = np.zeros((3, 3))
    if entries is not None:
        xx, yy, zz, xy, xz, yz = entries
        inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        check_inertia(inertia, "payload.inertia", section.where)
    section.finish()
    return Body.from_center(mass, np.array(com), inertia)


def _load(light: Chain, heavy: Chain) -> Load | None:
    """Return the load of 1 and 2 kg in two chains; None where it rests on the base."""
    for link, (one, two) in enumerate(zip(light.links, heavy.links, strict=True)):
        if one.body.mass != two.body.mass:
            per_kg = two.body + one.body.scaled(-1.0)
            return Load(link, one.body + per_kg.scaled(-1.0), per_kg)
    return None


def _imus(root: Section, chain: Chain) -> tuple[Imu, ...]:
    section = root.section("imus")
    if section is None:
        return ()
    return tuple(Imu.read(name, section.required_section(name), chain) for name in section.keys())


def could_vary(joints: tuple[Joint, ...], chain: Chain, imus: tuple[Imu, ...]) -> list[Varied]:
    """Return the numbers of joints, measurement units and links that may be varied."""
    of_joints = [
        one
        for joint in joints
        for part in (*joint.parts, *joint.sensors.parts.values())
        for one in part.could_vary(joint.name)
    ]
    of_imus = [one for imu in imus for one in imu.could_vary()]
    of_links = [one for joint in chain.joints for one in varied_body(joint)]
    return of_joints + of_imus + of_links


def _possible_faults(
    joints: tuple[Joint, ...], chain: Chain, imus: tuple[Imu, ...], payload: float | None
) -> dict[str, SceneFault]:
    """Return the faults that a scene could list, by their names; `payload` is its mass [kg]."""
    # Only where they are asked for: most scenes have none and are loaded in less time.
    from arm_emulator.machine.faults.known import FAULTS

    parts = [
        *((joint.name, part) for joint in joints
          for part in (*joint.parts, *joint.sensors.parts.values())),
        *((imu.name, part) for imu in imus for part in imu.parts),
    ]  # fmt: skip
    numbers = {
        f"{part.owners}.{name}.{part.section}.{key}": value
        for name, part in parts
        for key, value in part.own_numbers().items()
    }
    numbers |= {one.name: one.value for joint in chain.joints for one in varied_body(joint)}
    numbers |= {f"joints.{joint.name}.brake.closed": 0.0 for joint in joints if joint.brake}
    if payload is not None:
        numbers["payload.mass"] = payload
    owners = {
        "joints": [joint.name for joint in joints],
        "links": [joint.link for joint in chain.joints],
        "imus": [imu.name for imu in imus],
    }
    return faults_of(FAULTS, owners, numbers)


def _dividing(servo_period: float, dt: float, where: str) -> float:
    """Return the step [s] of which whole steps make a servo period, for one that has few digits."""
    nanoseconds = servo_period * 1e9
    # But for the rounding of a number that stands for whole nanoseconds.
    if abs(nanoseconds - round(nanoseconds)) > 4.0 * sys.float_info.epsilon * nanoseconds:
        nearest = f"{round(nanoseconds) * 1e-9:.10g} s, for example"
        rule = "be a whole number of nanoseconds"
        raise Refusal(where, "servo_period", rule, servo_period, nearest)
    steps = servo_period / dt
    if round(steps) < 1 or abs(steps - round(steps)) > 1e-9 * steps:
        fitting = servo_period / max(1, math.ceil(steps - 1e-9))
        raise Refusal(
            where,
            "integrator.dt",
            f"divide the servo period of {servo_period:g} s",
            dt,
            f"{fitting!r} s, for example",
        )
    if steps > LARGEST_COUNT:
        raise Refusal(where, "integrator.dt", f"be >= {servo_period / LARGEST_COUNT:g} s", dt)
    return servo_period / round(steps)


# Files


def example_robot_data() -> Path | None:
    """Return the folder of robots of the package example-robot-data, None if not installed."""
    roots = [Path(entry) / "cmeel.prefix" for entry in sys.path if entry]
    roots += map(Path, filter(None, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)))
    for root in roots:
        folder = root / "share" / "example-robot-data" / "robots"
        if folder.is_dir():
            return folder
    return None


def _find_urdf(text: str, scene_file: Path) -> Path:
    package, colon, rest = text.partition(":")
    if colon and package == "example-robot-data":
        folder = example_robot_data()
        if folder is None:
            raise Refusal(
                scene_file.name,
                "urdf",
                "be in the package example-robot-data",
                "no such package",
                "install it with `make robots` or `pip install example-robot-data`",
            )
        inside = os.path.normpath(rest)
        if os.path.isabs(inside) or inside.split(os.sep)[0] == "..":
            rule = "be a file below robots/ of the package example-robot-data"
            raise Refusal(scene_file.name, "urdf", rule, text)
        file = folder / inside
    else:
        file = scene_file.parent / text
    reason = why_no_file(file)
    if reason is not None:
        raise Refusal(scene_file.name, "urdf", "be a file", f"{text} ({reason})")
    return file


def override(data: dict[str, Any], dotted: str, value: object, where: str) -> None:
    """Put a value into what a scene file holds, see `load_scene`."""
    places: list[tuple[dict[str, Any], list[str]]] = [(data, dotted.split("."))]
    while places:
        place, steps = places.pop()
        for key, rest in _keys(place, steps):
            if not rest:
                if value is None:
                    place.pop(key, None)
                else:
                    place[key] = value
                continue
            # A copy, since YAML anchors make several joints share one mapping.
            child = place.get(key)
            if child is None:
                child = {}
            if not isinstance(child, dict):
                raise Refusal(where, f"override {dotted}", "lead through sections", child)
            place[key] = dict(child)
            below = [".".join(rest)] if key == "locked" and place is data else rest
            places.append((place[key], below))


def _plain(value: object) -> object:
    """Return a value as a file would give it: numbers of Python, sequences as lists."""
    if isinstance(value, np.floating):
        return float(str(value))  # the digits that it stands for, whatever its width
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    if isinstance(value, Mapping):
        return {key: _plain(one) for key, one in value.items()}
    return [_plain(one) for one in value] if isinstance(value, list | tuple) else value


def _keys(place: dict[str, Any], steps: list[str]) -> list[tuple[str, list[str]]]:
    """Return the keys that the first steps of a dotted path mean, with the steps that remain.

    Names of joints may have dots: the longest key that is there is meant.
    """
    if steps[0] == "*":
        return [(key, steps[1:]) for key in list(place)]
    for count in range(len(steps), 1, -1):
        key = ".".join(steps[:count])
        if key in place:
            return [(key, steps[count:])]
    return [(steps[0], steps[1:])]
