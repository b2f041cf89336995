"""Motors, gears and friction for an arm of which only the links are known: rules of thumb.

They give a machine of the right kind and size to begin with, not the machine that somebody built.
Each rule has its reason; replace what you know.
"""

import dataclasses
import math
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from arm_emulator.design.data_sheets import JointSheet
from arm_emulator.machine.parts.measuring.sensors import JointSensors
from arm_emulator.machine.parts.motors.motor import Motor, Rating
from arm_emulator.machine.parts.part import Part
from arm_emulator.machine.scene.joint import Joint
from arm_emulator.machine.scene.known_parts import DECORATORS, MOTORS, find_gear, link_friction_of

# Largest plausible limits of a description. Larger ones mean "unknown".
MAX_SPEED = {"revolute": 30.0, "prismatic": 10.0}  # rad/s, m/s
DEFAULT_SPEED = {"revolute": math.pi, "prismatic": 0.5}  # rad/s, m/s
# A torque of the description means "not known" beyond PLACEHOLDER times the torque that the joint
# needs with a tool. So does a torque of OVERSIZED times that torque at every joint. Makers' figures
# are up to 6 times.
PLACEHOLDER, OVERSIZED = 20.0, 8.0
UNDERSIZED = 20.0  # likewise below so many times less, for joints on which no weight rests
ALIKE = 3  # joints that have one figure are all without one, where one of them cannot have it

GRAVITY_MARGIN = 1.3  # holds its own links, and some payload
SPEED_UP = 0.25  # s from rest to full speed
TORQUE_PART = 0.6  # of what the weight leaves of the torque, for accelerating
MIN_PART = 0.02  # of the torque, for accelerating where the weight leaves less

SUPPLIES = ((50.0, 24.0), (2000.0, 48.0), (math.inf, 560.0))  # W of the strongest joint, V
MOTOR_SPEED = 314.0  # rad/s at the joint's full speed: 3000 rpm, rated speed of most servo motors
BACK_EMF_PART = 0.6  # of the supply at full speed
RESISTANCE_PART = 0.25  # of the supply at peak torque; 0.15 are left for control
# Windings of servo motors above some watts have less, in catalogues for 24 to 560 V: a motor whose
# torque needs more is larger than necessary, and its current limit keeps the torque.
MAX_RESISTANCE = 100.0  # ohm
ELECTRICAL_TIME = 1e-3  # s, L/R of frameless and small servo motors
CURRENT_BANDWIDTH = 1000.0  # Hz, of drives that sample at 16 kHz
ROTOR_ACCELERATION = 1.4e4  # rad/s2 at peak torque, with the gear's primary side
# Of the heaviest link over the rotor's: through a lighter rotor a servo moves what is on an elastic
# gear slowly. Makers of servo motors advise 10 to 30.
INERTIA_RATIO = 20.0
STIFFNESS_PER_TORQUE = 170.0  # 1/rad: strain wave gears of sizes 14 to 40, to their peak torque
LOWEST_RESONANCE = {"revolute": 2 * math.pi * 12.0, "prismatic": 2 * math.pi * 30.0}  # rad/s
DAMPING = 0.05  # of critical, of the link on its gear
FRICTION_PART = 0.1  # of the peak torque at full speed
FEWEST_BITS, MAX_BITS = 13, 15  # of the encoder at the motor
COUNT_PART = 0.05  # of the acceleration, that a count of wind-up gives a link on its gear


@dataclass(frozen=True)
class Demand:
    """Loads of the links on a joint, and its limits in the robot description.

    Units are those of a revolute joint; for a prismatic one read kg, N and m/s.
    """

    name: str
    kind: str  # revolute or prismatic
    start: float  # rad
    inertia: tuple[float, float]  # kg m2, least and most over poses
    coupling: tuple[float, ...]
    """Inertia felt from each joint's acceleration, its own included, largest over poses [kg m2]."""
    gravity_torque: float  # N m, most over poses, with the payload
    bare_torque: float  # N m, the same without the payload
    tool_weight: float  # N m, most over poses, of the links with the tool they are rated for
    tool_inertia: float  # kg m2, likewise, that the joint feels with all others held
    effort: float | None  # N m
    velocity: float | None  # rad/s
    sheet: JointSheet | None = None  # of its drive, where one is published
    limited: bool = False  # whether the description has limits of its position


@dataclass(frozen=True)
class Sized:
    """A joint's drive."""

    joint: Joint
    peak_torque: float  # N m at the link
    speed: float  # rad/s of the link
    acceleration: float  # rad/s2, for motion control
    notes: dict[str, str]
    """Sources of `torque` and `speed`, as text."""
    text: tuple[str, ...] = ()  # of its parts, where a data file has them


def size_drives(demands: list[Demand], kind: type[Motor] = MOTORS[0]) -> tuple[float, list[Sized]]:
    """Return the supply voltage [V] and a drive for every joint, with motors of a kind.

    Peak torque and speed are those published, else those of the description. Else they suffice to
    hold and move the links with the tool that they are rated for. Torques of makers are kept:
    accelerations follow from them. The motor's rated speed determines ratio and back EMF, the
    voltage that the supply leaves at peak torque the winding. A servo motor's acceleration
    determines the rotor. The stiffness is that of strain wave gears of that torque.
    """
    rated = [choose_full_speed(demand.kind, demand.velocity, demand.sheet) for demand in demands]
    speeds = np.array([speed for speed, _ in rated])
    weight = np.array([demand.gravity_torque for demand in demands])
    # Not all joints accelerate at the worst at a time: the root of the sum of squares.
    coupling = np.array([demand.coupling for demand in demands])
    ramp = np.linalg.norm(coupling * speeds, axis=1)  # of a second
    torques, notes = [], []
    links_alone = GRAVITY_MARGIN * weight + ramp / SPEED_UP
    # With its tool a joint is rated for its own acceleration, not for that of all at a time.
    tool_weight = np.array([demand.tool_weight for demand in demands])
    tool_inertia = np.array([demand.tool_inertia for demand in demands])
    loaded = GRAVITY_MARGIN * tool_weight + tool_inertia * speeds / SPEED_UP
    needs = np.maximum(links_alone, loaded)
    shares = [
        demand.effort / need
        for demand, need in zip(demands, needs, strict=True)
        if demand.effort is not None
    ]
    factor = PLACEHOLDER if min(shares, default=0.0) <= OVERSIZED else 0.0
    bounds = [
        (max(demand.bare_torque, alone / UNDERSIZED), factor * need)
        for demand, alone, need in zip(demands, links_alone.tolist(), needs.tolist(), strict=True)
    ]
    alike = {kind: _find_impossible_for_all(kind, demands, bounds) for kind in MAX_SPEED}
    for j, (demand, (_, of_speed), needed) in enumerate(
        zip(demands, rated, needs.tolist(), strict=True)
    ):
        torque, about = _choose_peak_torque(demand, needed, *bounds[j], alike[demand.kind])
        torques.append(torque)
        notes.append({"torque": about, "speed": of_speed})
    # Each joint for itself, as much as all joints can hold; what several ask for at a time is
    # kept by the timing of ways.
    peak = np.array(torques)
    left = np.maximum(TORQUE_PART * (peak - weight), MIN_PART * peak)
    required = (coupling / left[:, None]).max(axis=0)  # per acceleration, of what is left
    accelerations = 1.0 / np.maximum(SPEED_UP / speeds, required)
    supply = _choose_supply(demands, float((peak * speeds).max()))
    return supply, [
        _size_drive(demand, torque, float(speed), float(acceleration), note, supply, kind)
        for demand, torque, speed, acceleration, note in zip(
            demands, torques, speeds, accelerations, notes, strict=True
        )
    ]


def _choose_supply(demands: list[Demand], power: float) -> float:
    """Return the supply voltage of drives whose strongest has a power [W]."""
    supplies = [demand.sheet.supply for demand in demands if demand.sheet is not None]
    stated = [supply for supply in supplies if supply is not None]
    return max(stated) if stated else next(volts for watts, volts in SUPPLIES if power <= watts)


def choose_full_speed(
    kind: str, stated: float | None, sheet: JointSheet | None
) -> tuple[float, str]:
    """Return a joint's full speed [rad/s or m/s], and where it comes from.

    Args:
        kind: revolute or prismatic.
        stated: by the description; None: it gives none.
        sheet: of the joint's drive, where one is published.
    """
    if sheet is not None:
        return sheet.speed, f"published, {sheet.source}"
    if stated is not None and 0.0 < stated <= MAX_SPEED[kind]:
        return stated, "URDF"
    why = "none in the URDF" if stated is None else f"the URDF's {stated:g} is a placeholder"
    return DEFAULT_SPEED[kind], f"guess, {why}"


def _find_impossible_for_all(
    kind: str, demands: list[Demand], bounds: list[tuple[float, float]]
) -> str:
    """Return the joint that cannot have the figure of all joints of a kind; empty: none."""
    pairs = [
        (demand, ends)
        for demand, ends in zip(demands, bounds, strict=True)
        if demand.kind == kind and demand.sheet is None
    ]
    stated = {demand.effort for demand, _ in pairs}
    if len(pairs) < ALIKE or len(stated) > 1 or None in stated:
        return ""
    for demand, (smallest, largest) in pairs:
        if not smallest <= (demand.effort or 0.0) <= largest:
            return demand.name
    return ""


def _choose_peak_torque(
    demand: Demand, needed: float, smallest: float, largest: float, alike: str
) -> tuple[float, str]:
    """Return a joint's peak torque, and where it comes from.

    Args:
        demand: on the joint.
        needed: by the rules.
        smallest: a smaller figure of the description is refused.
        largest: likewise.
        alike: the joint that cannot have the figure of all; empty: none.
    """
    if demand.sheet is not None:
        return demand.sheet.torque, f"published, {demand.sheet.source}"
    stated = demand.effort
    if stated is not None and not alike and smallest <= stated <= largest:
        return stated, "URDF"
    if stated is None:
        why = "none in the URDF"
    elif smallest <= stated <= largest:
        why = (
            f"the URDF's {stated:g} is a placeholder, that of all joints, which {alike} cannot have"
        )
    elif stated > largest:
        why = f"the URDF's {stated:g} is a placeholder, {stated / needed:.2g} times what it needs"
    elif stated > demand.bare_torque:
        why = f"the URDF's {stated:g} is a placeholder, {stated / needed:.2g} of what it needs"
    else:
        why = f"the URDF's {stated:g} does not hold its own links, {demand.bare_torque:.3g}"
    rule = f"{GRAVITY_MARGIN:g} times the weight and full speed in {SPEED_UP:g} s, with a tool"
    return needed, f"guess, {why}: {rule}"


def _size_drive(
    demand: Demand,
    torque: float,
    speed: float,
    acceleration: float,
    notes: dict[str, str],
    supply: float,
    kind: type[Motor],
) -> Sized:
    servo = None if demand.sheet is None else demand.sheet.servo
    if servo is None:
        ratio = speed / MOTOR_SPEED
        back_emf_constant = torque_constant = BACK_EMF_PART * supply / MOTOR_SPEED
        current = torque * ratio / torque_constant
        resistance = min(RESISTANCE_PART * supply / current, MAX_RESISTANCE)
    else:
        ratio, resistance = 1.0 / servo.turns, servo.resistance
        torque_constant, back_emf_constant = servo.torque_constant, servo.back_emf_constant
        current = torque * ratio / torque_constant
    smallest, largest = demand.inertia
    stiffness = max(STIFFNESS_PER_TORQUE * torque, LOWEST_RESONANCE[demand.kind] ** 2 * largest)
    middle = math.sqrt(smallest * largest)
    count = (
        2.0 * math.pi * ratio * stiffness / max(smallest, 1e-9)
    )  # rad/s2, of one count in a turn
    finest = math.ceil(math.log2(max(1.0, count / (COUNT_PART * acceleration))))
    bits = min(max(FEWEST_BITS, finest), MAX_BITS)
    rating = Rating(
        torque=torque * ratio,
        rotor_inertia=max(torque * ratio / ROTOR_ACCELERATION, largest * ratio**2 / INERTIA_RATIO),
        torque_constant=torque_constant,
        back_emf_constant=back_emf_constant,
        resistance=resistance,
        inductance=ELECTRICAL_TIME * resistance,
        bandwidth=CURRENT_BANDWIDTH,
    )
    motor = kind.size_part(rating)
    around = (decorator.find_kind(motor).size_part(motor, rating) for decorator in DECORATORS)
    joint = Joint(
        name=demand.name,
        start=demand.start,
        motor=_round_part(motor),
        gear=find_gear(
            ratio=round_figure(ratio, 6),
            stiffness=round_figure(stiffness),
            damping=round_figure(2.0 * DAMPING * math.sqrt(stiffness * middle)),
        ),
        sensors=JointSensors.add_counts(2**bits),
        friction=link_friction_of(viscous=round_figure(FRICTION_PART * torque / speed)),
        decorators=tuple(_round_part(part) for part in around if part is not None),
    )
    if demand.sheet is not None and (data := demand.sheet.data) is not None:
        sized = dataclasses.replace(
            data.joint, name=joint.name, start=joint.start, sensors=joint.sensors
        )
        return Sized(sized, torque, speed, acceleration, notes, data.text)
    return Sized(joint, torque, speed, acceleration, notes)


_Kind = TypeVar("_Kind", bound=Part)


def _round_part(part: _Kind) -> _Kind:
    """Return a part with numbers as a data sheet would give them."""
    values = {
        key: getattr(part, key) for key, number in part.list_numbers().items() if not number.whole
    }
    return dataclasses.replace(
        part, **{key: round_figure(value) for key, value in values.items() if value is not None}
    )


def round_figure(value: float, digits: int = 3) -> float:
    """Return a value as a data sheet would give it."""
    return float(f"{value:.{digits}g}")
