"""The parts that a scene may have. A new part is entered here, and nowhere else."""

from __future__ import annotations

from emulator_node.parts.backlash_gear import BacklashGear
from emulator_node.parts.brake import Brake
from emulator_node.parts.cogging import Cogging
from emulator_node.parts.counterbalance import Counterbalance
from emulator_node.parts.current_loop import CurrentLoop
from emulator_node.parts.current_motor import CurrentMotor
from emulator_node.parts.dc_motor import DcMotor
from emulator_node.parts.elastic_gear import ElasticGear
from emulator_node.parts.end_stops import EndStops
from emulator_node.parts.friction import Friction, LinkFriction, RotorFriction
from emulator_node.parts.gear import Gear, RigidGear
from emulator_node.parts.kinematic_error_gear import KinematicErrorGear
from emulator_node.parts.load_friction import LinkLoadFriction, RotorLoadFriction
from emulator_node.parts.lugre import LinkLuGre, RotorLuGre
from emulator_node.parts.motor import Motor
from emulator_node.parts.part import Part
from emulator_node.parts.pmsm import Pmsm
from emulator_node.parts.progressive_gear import ProgressiveGear
from emulator_node.parts.stribeck import LinkStribeck, RotorStribeck
from emulator_node.parts.torque_motor import TorqueMotor
from emulator_node.parts.torque_ripple import TorqueRipple
from emulator_node.parts.torque_table import TorqueTable
from emulator_node.parts.winding import Winding
from emulator_node.section import Section

# The first is meant where a scene gives no `motor.kind`.
MOTORS: tuple[type[Motor], ...] = (
    DcMotor,
    TorqueMotor,
    CurrentMotor,
    Pmsm,
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

# Parts that stand in a section of their own, if there is one.
EXTRAS: tuple[type[Part], ...] = (
    Counterbalance,
    EndStops,
    LinkLuGre,
    RotorLuGre,
    Cogging,
    TorqueTable,
)

PARTS: tuple[type[Part], ...] = (
    *MOTORS,
    CurrentLoop,
    Winding,
    TorqueRipple,
    *GEARS,
    *LINK_FRICTIONS,
    *ROTOR_FRICTIONS,
    Brake,
    *EXTRAS,
)


def read_motor(section: Section) -> Motor:
    """Return the motor that a section describes."""
    kinds = {motor.kind: motor for motor in MOTORS}
    return kinds[section.choice("kind", tuple(kinds), default=MOTORS[0].kind)].read(section)


def read_gear(section: Section) -> Gear:
    """Return the gear that a section describes."""
    kind = next(one for one in GEARS if all(map(section.has, one.told_by)))
    gear = kind.read(section)
    if gear.stiffness is None:
        for key in {key: None for one in GEARS for key in one.numbers()}:
            if key not in kind.numbers() and section.has(key):
                rule = "come with a stiffness (a rigid gear has none)"
                raise section.refusal(key, rule, "alone")
    return gear


def read_friction(section: Section, kinds: tuple[type[Friction], ...]) -> Friction:
    """Return the friction that a section describes, of a link or of a rotor."""
    return next(one for one in kinds if all(map(section.has, one.told_by))).read(section)


def read_extras(joint: Section) -> tuple[Part, ...]:
    """Return the parts of a joint that stand in sections of their own."""
    found = []
    for kind in EXTRAS:
        section: Section | None = joint
        for key in kind.section.split("."):
            section = section and section.section(key)
        if section is not None:
            found.append(kind.read(section))
    return tuple(found)
