"""The parts that a scene may have.

A new one is entered here and nowhere else; motors, decorators and sensors are found by their files.
"""

from __future__ import annotations

from arm_emulator.base.section import Section
from arm_emulator.machine.parts.backlash_gear import BacklashGear
from arm_emulator.machine.parts.brake import Brake
from arm_emulator.machine.parts.cogging import Cogging
from arm_emulator.machine.parts.counterbalance import Counterbalance
from arm_emulator.machine.parts.current_loop import CurrentLoop
from arm_emulator.machine.parts.dc_motor import DcMotor
from arm_emulator.machine.parts.decorator import Decorator
from arm_emulator.machine.parts.elastic_gear import ElasticGear
from arm_emulator.machine.parts.end_stops import EndStops
from arm_emulator.machine.parts.found import kinds_of
from arm_emulator.machine.parts.friction import Friction, LinkFriction, RotorFriction
from arm_emulator.machine.parts.gear import Gear, RigidGear
from arm_emulator.machine.parts.kinematic_error_gear import KinematicErrorGear
from arm_emulator.machine.parts.load_friction import LinkLoadFriction, RotorLoadFriction
from arm_emulator.machine.parts.lugre import LinkLuGre, RotorLuGre
from arm_emulator.machine.parts.motor import Motor
from arm_emulator.machine.parts.part import Part
from arm_emulator.machine.parts.progressive_gear import ProgressiveGear
from arm_emulator.machine.parts.stribeck import LinkStribeck, RotorStribeck
from arm_emulator.machine.parts.torque_table import TorqueTable

# The first is meant where a scene gives no `motor.kind`.
MOTORS: tuple[type[Motor], ...] = (
    DcMotor,
    *(one for one in kinds_of(Motor) if one is not DcMotor),
)

# A gear is the first of these whose keys it has all.
GEARS: tuple[type[Gear], ...] = (
    ProgressiveGear,
    BacklashGear,
    KinematicErrorGear,
    ElasticGear,
    RigidGear,
)

# And so is friction.
LINK_FRICTIONS: tuple[type[LinkFriction], ...] = (LinkLoadFriction, LinkStribeck, LinkFriction)
ROTOR_FRICTIONS: tuple[type[Friction], ...] = (RotorLoadFriction, RotorStribeck, RotorFriction)

# Parts with an optional section of their own.
EXTRAS: tuple[type[Part], ...] = (
    Counterbalance,
    EndStops,
    LinkLuGre,
    RotorLuGre,
    Cogging,
    TorqueTable,
)

# Decorators around a motor, innermost first.
DECORATORS = tuple(sorted(kinds_of(Decorator), key=lambda one: one.layer))

# Of motors that have one of their own.
LOOPS: tuple[type[CurrentLoop], ...] = tuple(CurrentLoop.__subclasses__())

PARTS: tuple[type[Part], ...] = (
    *MOTORS,
    *DECORATORS,
    *LOOPS,
    *GEARS,
    *LINK_FRICTIONS,
    *ROTOR_FRICTIONS,
    Brake,
    *EXTRAS,
)


def read_motor(section: Section) -> Motor:
    """Return the motor that a section describes."""
    kinds = {motor.kind: motor for motor in MOTORS}
    return kinds[section.choice("kind", tuple(kinds), default=DcMotor.kind)].read(section)


def read_decorators(motor: Motor, section: Section) -> tuple[Decorator, ...]:
    """Return the decorators of a motor's section, innermost first."""
    given = ((kind, section.section(kind.section.partition(".")[2])) for kind in DECORATORS)
    return tuple(kind.of(motor).read(one) for kind, one in given if one is not None)


def read_gear(section: Section) -> Gear:
    """Return the gear that a section describes."""
    kind = next(one for one in GEARS if all(map(section.has, one.named_by)))
    gear = kind.read(section)
    if gear.stiffness is None:
        for key in {key: None for one in GEARS for key in one.numbers()}:
            if key not in kind.numbers() and section.has(key):
                rule = "come with a stiffness (a rigid gear has none)"
                raise section.refusal(key, rule, "alone")
    return gear


def read_friction(section: Section, kinds: tuple[type[Friction], ...]) -> Friction:
    """Return the friction that a section describes, of a link or of a rotor."""
    return next(one for one in kinds if all(map(section.has, one.named_by))).read(section)


def read_extras(joint: Section) -> tuple[Part, ...]:
    """Return the parts of a joint that stand in sections of their own."""
    found = []
    for kind in EXTRAS:
        section = joint.below(kind.section)
        if section is not None:
            found.append(kind.read(section))
    return tuple(found)
