"""A scene: one YAML file and one URDF, checked once and frozen.

What the file does not mention does not exist in the machine. Every refusal says where, which
quantity, which rule, which value.
"""

from __future__ import annotations

import math
import os
import sys
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from emulator_node.chain import Array, Body, Chain, check_inertia, lock_joints, read_chain
from emulator_node.varied import Varied, choose_varied
from words.config_files import BESIDE, find_config
from words.refusal import Refusal
from words.text_file import why_no_file
from words.urdf_text import parse_urdf, read_urdf
from words.yaml_file import read_yaml

SCHEMES = ("rosenbrock", "extrapolated", "implicit", "paper")
EXCHANGES = ("predict", "lag")
EVENTS = ("step", "located")
# Numbers beyond these are slips, and what is computed from several of them may overflow.
SMALLEST, LARGEST = 1e-15, 1e15  # of numbers above 0, and of all, where no other bound is given
LARGEST_COUNT = 1_000_000_000  # steps per servo period, counts per turn: beyond is a slip


@dataclass(frozen=True)
class Motor:
    """Armature circuit and rotor, eq. (1) and (2). `inductance` 0: the current follows at once."""

    resistance: float  # ohm
    inductance: float  # H
    torque_constant: float  # N m/A
    back_emf_constant: float  # V s/rad
    rotor_inertia: float  # kg m2, with the gear's primary side
    current_limit: float | None  # A


@dataclass(frozen=True)
class Gear:
    """Gear between motor and link, eq. (2). `stiffness` None: rigid; `cubic_stiffness`: linear."""

    ratio: float = 1.0  # link turns per motor turn (m per rad for a prismatic joint)
    stiffness: float | None = None  # N m/rad at the link
    damping: float = 0.0  # N m s/rad at the link
    cubic_stiffness: float | None = None  # N m/rad3 at the link

    def wind_up(self, torque: float) -> float:
        """Return the angle by which the gear gives way at rest [rad], seen at the link."""
        if self.stiffness is None:
            return 0.0
        if not self.cubic_stiffness:
            return torque / self.stiffness
        # Kg w + Kg3 w^3 = T as 4 s^3 + 3 s = sinh(3 t), s = sinh(t): its only real root.
        scale = math.sqrt(4.0 * self.stiffness / (3.0 * self.cubic_stiffness))
        three_t = math.asinh(3.0 * torque / (self.stiffness * scale))
        return scale * math.sinh(three_t / 3.0)


@dataclass(frozen=True)
class Encoder:
    """Incremental encoder on the motor shaft: floor(theta_m / (2 pi) * counts_per_turn)."""

    counts_per_turn: int


@dataclass(frozen=True)
class Friction:
    """Friction at the link. `breakaway` >= `coulomb`: what a joint at rest withstands."""

    viscous: float = 0.0  # N m s/rad, Dl of eq. (4)
    coulomb: float = 0.0  # N m while sliding
    breakaway: float = 0.0  # N m


@dataclass(frozen=True)
class Load:
    """A payload whose mass is varied: the link that carries it, and what it adds to that link."""

    link: int
    bare: Body  # the link without it
    per_kg: Body  # what 1 kg more adds


# What a joint without an encoder reports, since encoder counts are whole numbers.
IDEAL_COUNTS_PER_TURN = 2**20


@dataclass(frozen=True)
class Joint:
    """What the scene file says of one moving joint. A joint without a motor swings freely."""

    name: str
    start: float  # rad or m
    motor: Motor | None
    gear: Gear
    encoder: Encoder | None
    friction: Friction

    @property
    def counts_per_turn(self) -> int:
        """Counts of the encoder in a turn of the motor; without one, of the finest there is."""
        return self.encoder.counts_per_turn if self.encoder else IDEAL_COUNTS_PER_TURN


@dataclass(frozen=True)
class Integrator:
    """Scheme and step [s]."""

    scheme: str
    dt: float
    exchange: str  # between two threads, see core/two_threads.hpp
    events: str  # where modes of joints change, see core/located.hpp


@dataclass(frozen=True)
class Scene:
    """Everything that there is about one machine."""

    name: str
    where: str  # the file, for refusals
    urdf: str  # XML text, locked joints fixed
    tool: str  # link whose frame is the tool
    gravity: tuple[float, float, float] | None  # m/s2 in the world
    supply_voltage: float  # V
    joints: tuple[Joint, ...]  # base to tool
    chain: Chain  # the same joints' geometry and inertia
    integrator: Integrator
    servo_period: float  # s
    energy_flow: bool  # whether what is given and dissipated is told, see core/energy_flow.hpp
    threads: int
    cores: tuple[int, int]  # of the motor thread and the Newton-Euler thread; -1: any
    varied: tuple[Varied, ...]  # numbers that every machine has for itself
    load: Load | None  # the payload, where its mass is varied

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the moving joints, base to tool."""
        return tuple(joint.name for joint in self.joints)

    @property
    def start(self) -> Array:
        """Joint positions at reset (N,) [rad or m]."""
        return np.array([joint.start for joint in self.joints])

    def wind_up(self, torques: Iterable[float]) -> Array:
        """Return by how much the gears give way at rest under torques (N,), at the links (N,)."""
        pairs = zip(self.joints, torques, strict=True)
        return np.array([joint.gear.wind_up(torque) for joint, torque in pairs])

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
    for dotted, value in (overrides or {}).items():
        _override(data, dotted, value, file.name)
    return _build(_Section(data, file.name, ""), file)


def _build(root: _Section, file: Path) -> Scene:
    where = file.name
    name = root.text("name", most_bytes=100)
    urdf_file = _find_urdf(root.text("urdf"), file)
    urdf = read_urdf(urdf_file)
    robot = parse_urdf(urdf, urdf_file.name)
    tool = root.text("tool")
    gravity = root.vector("gravity", "m/s2", bound=1000.0)
    payload = root.section("payload")
    locked_section = root.section("locked")
    locked = {}
    if locked_section is not None:
        locked = {
            key: locked_section.number(key, "rad or m", at_least=-1e4, at_most=1e4)
            for key in locked_section.keys()
        }
    payload_body = None if payload is None else _payload(payload)

    def read(load: Body | None) -> Chain:
        return read_chain(robot, urdf_file.name, locked=locked, tool=tool, payload=load)

    chain = read(payload_body)
    if lock_joints(robot, locked, urdf_file.name):
        urdf = ET.tostring(robot, encoding="unicode")
    supply_voltage = root.number("supply_voltage", "V", above=0.0, at_most=1e5)
    joints = _joints(root, chain, urdf_file.name)
    integrator_section = root.section("integrator", required=True)
    integrator = Integrator(
        scheme=integrator_section.choice("scheme", SCHEMES, default=SCHEMES[0]),
        dt=integrator_section.number("dt", "s", at_least=1e-9, at_most=1.0),
        exchange=integrator_section.choice("exchange", EXCHANGES, default=EXCHANGES[0]),
        events=integrator_section.choice("events", EVENTS, default=EVENTS[0]),
    )
    integrator_section.finish()
    servo_period = root.number("servo_period", "s", at_least=1e-6, at_most=1.0)
    _check_periods(servo_period, integrator.dt, where)
    threads = root.integer("threads", default=1, at_least=1, at_most=2)
    if threads == 2 and integrator.scheme == "rosenbrock":
        rule = "be 1 with scheme rosenbrock, whose second stage waits for its first"
        raise root.refusal("threads", rule, 2, "2 with another scheme")
    if integrator.events == "located":
        rule = valid = ""
        if integrator.scheme in ("implicit", "paper"):
            rule = f"be step with scheme {integrator.scheme}, of first order at any event"
            valid = "step, or located with scheme rosenbrock or extrapolated"
        elif threads == 2:
            rule = "be step with 2 threads, whose links come from one sample ago"
            valid = "step, or located with threads: 1"
        if rule:
            raise root.refusal("integrator.events", rule, "located", valid)
    cores = _cores(root)
    mass = payload_body.mass if payload_body is not None else None
    varied = choose_varied(root.entries("varied"), _could_vary(joints, mass), where)
    load = None
    if payload_body is not None and any(one.name == "payload.mass" for one in varied):
        load = _load(*(read(_payload(payload, mass=kg)) for kg in (1.0, 2.0)))
    energy_flow = root.flag("energy_flow")
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
        supply_voltage=supply_voltage,
        joints=joints,
        chain=chain,
        integrator=integrator,
        servo_period=servo_period,
        energy_flow=energy_flow,
        threads=threads,
        cores=cores,
        varied=varied,
        load=load,
    )


def _cores(root: _Section) -> tuple[int, int]:
    cores = root.vector("cores", "core number", bound=1023.0, size=2)
    if cores is None:
        return -1, -1
    available = os.sched_getaffinity(0)
    if not set(cores) <= available:
        valid = ", ".join(map(str, sorted(available)))
        raise root.refusal("cores", "be cores of this machine", list(cores), valid)
    return int(cores[0]), int(cores[1])


def _joints(root: _Section, chain: Chain, urdf_name: str) -> tuple[Joint, ...]:
    section = root.section("joints", required=True)
    names = [joint.name for joint in chain.joints]
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
    for name in names:
        one = section.section(name)
        if one is None:
            raise Refusal(
                root.where,
                f"joints.{name}",
                f"be given, {urdf_name} moves it",
                "nothing",
                "a section, or its position under `locked`",
            )
        joints.append(_joint(name, one))
    return tuple(joints)


def _joint(name: str, one: _Section) -> Joint:
    motor, gear, encoder = one.section("motor"), one.section("gear"), one.section("encoder")
    friction = one.section("friction")
    if motor is None:
        for key, part in (("gear", gear), ("encoder", encoder)):
            if part is not None:
                raise one.refusal(key, "belong to a joint with a motor", "no motor section")
    joint = Joint(
        name=name,
        start=one.number("start", "rad or m", default=0.0, at_least=-1e4, at_most=1e4),
        motor=None if motor is None else _motor(motor),
        gear=Gear() if gear is None else _gear(gear),
        encoder=None
        if encoder is None
        else Encoder(encoder.integer("counts_per_turn", at_least=1, at_most=LARGEST_COUNT)),
        friction=Friction() if friction is None else _friction(friction),
    )
    for part in (encoder, one):
        if part is not None:
            part.finish()
    if joint.motor is not None:
        _check_reflected(joint, joint.motor, one)
    return joint


def _check_reflected(joint: Joint, motor: Motor, one: _Section) -> None:
    """Refuse a gear that makes of sound numbers unsound ones at the link."""
    ratio = joint.gear.ratio
    reflected = {
        "rotor inertia": motor.rotor_inertia / ratio**2,
        "torque per current": motor.torque_constant / ratio,
        "voltage per speed": motor.back_emf_constant / ratio,
    }
    for what, value in reflected.items():
        if value > LARGEST:
            rule = f"make the {what} at the link at most {LARGEST:g}"
            raise one.refusal("gear.ratio", rule, f"{value:.3g} with {ratio:g}")


def _motor(section: _Section) -> Motor:
    motor = Motor(
        resistance=section.number("resistance", "ohm", above=0.0),
        inductance=section.number("inductance", "H", default=0.0, at_least=0.0),
        torque_constant=section.number("torque_constant", "N m/A", above=0.0),
        back_emf_constant=section.number("back_emf_constant", "V s/rad", at_least=0.0),
        rotor_inertia=section.number("rotor_inertia", "kg m2", above=0.0),
        current_limit=section.number("current_limit", "A", above=0.0)
        if "current_limit" in section.keys()
        else None,
    )
    section.finish()
    return motor


def _gear(section: _Section) -> Gear:
    ratio = section.number("ratio", "link turns per motor turn", above=0.0, at_most=1e3)
    stiffness = None
    if "stiffness" in section.keys():
        stiffness = section.number("stiffness", "N m/rad", above=0.0)
    elif "damping" in section.keys():
        raise section.refusal("damping", "come with a stiffness (a rigid gear has none)", "alone")
    damping = section.number("damping", "N m s/rad", default=0.0, at_least=0.0)
    cubic = None
    if section.has("cubic_stiffness"):
        cubic = section.number("cubic_stiffness", "N m/rad3", at_least=0.0)
        if stiffness is None:
            rule = "come with a stiffness (a rigid gear has none)"
            raise section.refusal("cubic_stiffness", rule, "alone")
    section.finish()
    return Gear(ratio, stiffness, damping, cubic)


def _friction(section: _Section) -> Friction:
    coulomb = section.number("coulomb", "N m", default=0.0, at_least=0.0)
    breakaway = section.number("breakaway", "N m", default=coulomb, at_least=coulomb)
    if breakaway > 0.0 and coulomb == 0.0:
        raise section.refusal("breakaway", "come with a coulomb friction", breakaway)
    viscous = section.number("viscous", "N m s/rad", default=0.0, at_least=0.0)
    section.finish()
    return Friction(viscous, coulomb, breakaway)


def _payload(section: _Section, mass: float | None = None) -> Body:
    """Return the payload in the frame of the tool; `mass` takes the place of the scene's."""
    given = section.number("mass", "kg", above=0.0)
    mass = given if mass is None else mass
    com = section.vector("com", "m", bound=100.0) or (0.0, 0.0, 0.0)
    entries = section.vector("inertia", "kg m2", size=6, bound=1e6)
    inertia = np.zeros((3, 3))
    if entries is not None:
        xx, yy, zz, xy, xz, yz = entries
        inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        check_inertia(inertia, "payload.inertia", section.where)
    section.finish()
    return Body.from_center(mass, np.array(com), inertia)


def _load(light: Chain, heavy: Chain) -> Load | None:
    """Return the load of 1 and 2 kg in two chains; None where it rests on the base."""
    for link, (one, two) in enumerate(zip(light.joints, heavy.joints, strict=True)):
        if one.body.mass != two.body.mass:
            per_kg = two.body + one.body.scaled(-1.0)
            return Load(link, one.body + per_kg.scaled(-1.0), per_kg)
    return None


def _could_vary(joints: tuple[Joint, ...], payload: float | None) -> dict[str, Varied]:
    """Return all numbers that a scene may list as varied, by name; the gear ratio is structure."""
    possible: dict[str, Varied] = {}

    def add(name: str, value: float | None, least: float, most: float = LARGEST) -> None:
        if value is not None:
            possible[name] = Varied(name, value, least, most)

    for joint in joints:
        at = f"joints.{joint.name}"
        if (motor := joint.motor) is not None:
            add(f"{at}.motor.resistance", motor.resistance, SMALLEST)
            add(f"{at}.motor.inductance", motor.inductance, 0.0)
            add(f"{at}.motor.torque_constant", motor.torque_constant, SMALLEST)
            add(f"{at}.motor.back_emf_constant", motor.back_emf_constant, 0.0)
            add(f"{at}.motor.rotor_inertia", motor.rotor_inertia, SMALLEST)
            add(f"{at}.motor.current_limit", motor.current_limit, SMALLEST)
        if (gear := joint.gear).stiffness is not None:
            add(f"{at}.gear.stiffness", gear.stiffness, SMALLEST)
            add(f"{at}.gear.damping", gear.damping, 0.0)
            add(f"{at}.gear.cubic_stiffness", gear.cubic_stiffness, 0.0)
        add(f"{at}.friction.viscous", joint.friction.viscous, 0.0)
        add(f"{at}.friction.coulomb", joint.friction.coulomb, 0.0)
    add("payload.mass", payload, SMALLEST)
    return possible


def _check_periods(servo_period: float, dt: float, where: str) -> None:
    nanoseconds = servo_period * 1e9
    if abs(nanoseconds - round(nanoseconds)) > 1e-6 * nanoseconds:
        raise Refusal(where, "servo_period", "be a whole number of nanoseconds", servo_period)
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


def _override(data: dict[str, Any], dotted: str, value: object, where: str) -> None:
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


def _as_float(value: float) -> float:
    """Return a number as a float; a whole number that is too large for one is infinite."""
    try:
        return float(value)
    except OverflowError:
        return math.inf if value > 0 else -math.inf


class _Section:
    """One mapping of the file, read key by key; `finish` refuses the keys nobody asked for."""

    def __init__(self, data: dict[str, Any], where: str, path: str) -> None:
        self.where = where
        self._data = data
        self._path = path
        self._read: set[str] = set()

    def keys(self) -> list[str]:
        return [str(key) for key in self._data]

    def has(self, key: str) -> bool:
        return key in self._data

    def refusal(self, key: str, rule: str, got: object, valid: str | None = None) -> Refusal:
        return Refusal(self.where, self._name(key), rule, got, valid)

    def section(self, key: str, required: bool = False) -> Any:
        value = self._take(key)
        if value is None and key not in self._data and not required:
            return None
        if value is None and not required:
            value = {}
        if not isinstance(value, dict):
            rule = "be a section of keys and values"
            raise self.refusal(key, rule, "nothing" if value is None else repr(value))
        return _Section(value, self.where, self._name(key))

    def text(self, key: str, most_bytes: int = 4096) -> str:
        value = self._take(key)
        if not isinstance(value, str) or not value:
            raise self.refusal(key, "be a text", "nothing" if value is None else repr(value))
        if not value.isprintable():
            raise self.refusal(key, "have printable letters only", repr(value))
        if len(value.encode()) > most_bytes:
            raise self.refusal(key, f"be at most {most_bytes} bytes long", repr(value))
        return value

    def choice(self, key: str, choices: tuple[str, ...], default: str) -> str:
        value = self._take(key)
        if key not in self._data:
            return default
        if value not in choices:
            got = "nothing" if value is None else repr(value)
            raise self.refusal(key, "be one of the known", got, ", ".join(choices))
        return str(value)

    def flag(self, key: str) -> bool:
        value = self._take(key)
        if key in self._data and not isinstance(value, bool):
            got = "nothing" if value is None else repr(value)
            raise self.refusal(key, "be true or false", got)
        return bool(value)

    def number(
        self,
        key: str,
        unit: str,
        *,
        default: float | None = None,
        above: float | None = None,
        at_least: float | None = None,
        at_most: float | None = None,
    ) -> float:
        rules: list[tuple[str, Callable[[float], bool]]] = []
        if above is not None:
            least = above or SMALLEST
            rules.append((f"be > {above:g} {unit}", lambda x: x > above))
            rules.append((f"be >= {least:g} {unit}", lambda x: x >= least))
        if at_most is None:
            at_most = LARGEST
        if at_least is not None:
            rules.append((f"be >= {at_least:g} {unit}", lambda x: x >= at_least))
        if at_most is not None:
            rules.append((f"be <= {at_most:g} {unit}", lambda x: x <= at_most))
        value = self._take(key)
        if value is None and default is not None and key not in self._data:
            return default
        if isinstance(value, bool) or not isinstance(value, int | float):
            rule = f"be a number [{unit}]"
            raise self.refusal(key, rule, "nothing" if value is None else repr(value))
        value = _as_float(value)
        for rule, holds in [(f"be finite [{unit}]", math.isfinite), *rules]:
            if not holds(value):
                raise self.refusal(key, rule, value)
        return value

    def integer(self, key: str, *, default: int | None = None, at_least: int, at_most: int) -> int:
        value = self._take(key)
        if value is None and default is not None and key not in self._data:
            return default
        rule = f"be a whole number from {at_least} to {at_most}"
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise self.refusal(key, rule, "nothing" if value is None else repr(value))
        if not at_least <= value <= at_most or value != int(value):
            raise self.refusal(key, rule, value)
        return int(value)

    def vector(self, key: str, unit: str, *, bound: float, size: int = 3) -> Any:
        value = self._take(key)
        if value is None and key not in self._data:
            return None
        rule = f"be {size} numbers of at most {bound:g} [{unit}]"
        if not isinstance(value, list) or len(value) != size:
            raise self.refusal(key, rule, repr(value))
        for entry in value:
            if isinstance(entry, bool) or not isinstance(entry, int | float):
                raise self.refusal(key, rule, repr(value))
            if not abs(_as_float(entry)) <= bound:
                raise self.refusal(key, rule, value)
        return tuple(float(entry) for entry in value)

    def entries(self, key: str) -> list[object]:
        value = self._take(key)
        if key not in self._data:
            return []
        if not isinstance(value, list):
            raise self.refusal(key, "be a list", repr(value))
        return value

    def finish(self) -> None:
        for key in self._data:
            if key not in self._read:
                raise Refusal(
                    self.where,
                    f"key {self._name(str(key))}",
                    "be known",
                    repr(key),
                    ", ".join(sorted(self._read)),
                )

    def _take(self, key: str) -> Any:
        self._read.add(key)
        return self._data.get(key)

    def _name(self, key: str) -> str:
        return f"{self._path}.{key}" if self._path else key
