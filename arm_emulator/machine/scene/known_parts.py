"""The parts that a scene may have, from their registry."""

from collections.abc import Iterable, Sequence
from typing import TypeVar

from arm_emulator.base.validation.section import Section
from arm_emulator.machine.parts.bearing import Deflection
from arm_emulator.machine.parts.drive_stages.drive_stage import DriveStage
from arm_emulator.machine.parts.frictions.brake import Brake
from arm_emulator.machine.parts.frictions.friction import Friction, LinkFriction, OfRotor
from arm_emulator.machine.parts.gears.gear import Gear
from arm_emulator.machine.parts.gears.gear_stage import GearStage
from arm_emulator.machine.parts.joint_effects.joint_effect import JointEffect
from arm_emulator.machine.parts.motors.motor import Motor
from arm_emulator.machine.parts.part import Part
from arm_emulator.machine.parts.registry import list_kinds

KeyedPart = TypeVar("KeyedPart", bound=Gear | Friction)
AnyFriction = TypeVar("AnyFriction", bound=Friction)

# The first is meant where a scene gives no `motor.kind`.
MOTORS = tuple(sorted(list_kinds(Motor), key=lambda kind: not kind.is_default))

# Those that our servo drives, so that an arm can be sized with them.
SIZED_MOTORS = tuple(motor for motor in MOTORS if motor.rules)


def _select_by_keys(kinds: Iterable[type[KeyedPart]]) -> tuple[type[KeyedPart], ...]:
    return tuple(sorted(kinds, key=lambda kind: (-len(kind.named_by), kind.__module__)))


# A gear is the first of these whose keys it has all.
GEARS = _select_by_keys(list_kinds(Gear))

# Parts within a gear.
GEAR_STAGES = tuple(list_kinds(GearStage))

# And so is friction.
LINK_FRICTIONS = _select_by_keys(list_kinds(LinkFriction))
ROTOR_FRICTIONS = _select_by_keys(list_kinds(OfRotor))

# Parts with an optional section of their own.
EXTRAS = tuple(sorted(list_kinds(JointEffect), key=lambda kind: kind.rank))

# Directions in which a joint's bearing may give way.
DEFLECTIONS = tuple(list_kinds(Deflection))

# Decorators around a motor, innermost first.
_DECORATORS = sorted(list_kinds(DriveStage), key=lambda kind: kind.layer)
DECORATORS = tuple(kind for kind in _DECORATORS if not kind.around_kind)

# Those for motors of one kind, in the place of another.
_OF_SINGLE_MOTOR = tuple(kind for kind in _DECORATORS if kind.around_kind)

PARTS: tuple[type[Part], ...] = (
    *MOTORS,
    *DECORATORS,
    *_OF_SINGLE_MOTOR,
    *GEARS,
    *GEAR_STAGES,
    *LINK_FRICTIONS,
    *ROTOR_FRICTIONS,
    Brake,
    *EXTRAS,
    *DEFLECTIONS,
)


def remove_kind(kinds: Iterable[type[Part]]) -> dict[str, None]:
    """Return overrides of a scene that take parts of some kinds out of all joints."""
    return {f"joints.*.{kind.section}": None for kind in kinds}


def read_motor(section: Section) -> Motor:
    """Return the motor that a section describes."""
    kinds = {motor.kind: motor for motor in MOTORS}
    return kinds[section.read_choice("kind", tuple(kinds), default=MOTORS[0].kind)].read_section(
        section
    )


def read_decorators(motor: Motor, section: Section) -> tuple[DriveStage, ...]:
    """Return the decorators of a motor's section, innermost first."""
    sections = ((kind, section.get_section(kind.section.partition(".")[2])) for kind in DECORATORS)
    return tuple(
        kind.find_kind(motor).read_section(part_section)
        for kind, part_section in sections
        if part_section is not None
    )


def read_gear(section: Section) -> Gear:
    """Return the gear that a section describes."""
    kind = next(gear for gear in GEARS if all(map(section.has_key, gear.named_by)))
    gear = kind.read_section(section)
    if gear.stiffness is None:
        for key in {key: None for gear in GEARS for key in gear.list_numbers()}:
            if key not in kind.list_numbers() and section.has_key(key):
                rule = "come with a stiffness (a rigid gear has none)"
                raise section.make_refusal(key, rule, "alone")
    return gear


def read_gear_stages(joint: Section) -> tuple[GearStage, ...]:
    """Return the parts within the gear of a joint."""
    sections = ((kind, joint.find_section(kind.section)) for kind in GEAR_STAGES)
    return tuple(kind.read_section(section) for kind, section in sections if section is not None)


def find_gear(**numbers: float) -> Gear:
    """Return the gear that has these numbers."""
    return next(gear for gear in GEARS if set(gear.named_by) <= set(numbers))(**numbers)


def link_friction_of(**numbers: float) -> LinkFriction:
    """Return the friction of a link that has these numbers."""
    return next(kind for kind in LINK_FRICTIONS if set(kind.named_by) <= set(numbers))(**numbers)


def make_rotor_friction(**numbers: float) -> OfRotor:
    """Return the friction of a rotor that has these numbers."""
    return next(kind for kind in ROTOR_FRICTIONS if set(kind.named_by) <= set(numbers))(**numbers)


def read_friction(section: Section, kinds: Sequence[type[AnyFriction]]) -> AnyFriction:
    """Return the friction that a section describes, of a link or of a rotor."""
    return next(kind for kind in kinds if kind.is_named_in(section)).read_section(section)


def read_extras(joint: Section, limits: tuple[float, float] | None) -> tuple[JointEffect, ...]:
    """Return the parts of a joint that stand in sections of their own.

    Args:
        joint: the section of the joint.
        limits: of the joint in the URDF [rad or m], if it has any.
    """
    effects = []
    for kind in EXTRAS:
        section = joint.find_section(kind.section)
        if section is not None:
            kind.put_limits(section, limits)
            effects.append(kind.read_section(section))
    return tuple(effects)


def read_bearing(joint: Section) -> tuple[Deflection, ...]:
    """Return the directions in which the bearing of a joint gives way."""
    sections = ((kind, joint.find_section(kind.section)) for kind in DEFLECTIONS)
    return tuple(kind.read_section(section) for kind, section in sections if section is not None)
