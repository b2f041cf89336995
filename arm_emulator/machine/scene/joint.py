"""A moving joint of a scene: its motor, its gear, its sensors, its friction."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TypeVar

from arm_emulator.base.refusal import Refusal
from arm_emulator.base.validation.number import LARGEST, number
from arm_emulator.base.validation.section import Section
from arm_emulator.machine.chain import Chain
from arm_emulator.machine.parts.bearing import Deflection, name_deflection
from arm_emulator.machine.parts.drive_stages.drive_stage import DriveStage
from arm_emulator.machine.parts.frictions.brake import Brake
from arm_emulator.machine.parts.frictions.friction import Friction, OfRotor
from arm_emulator.machine.parts.gears.gear import Gear
from arm_emulator.machine.parts.gears.gear_stage import GearStage
from arm_emulator.machine.parts.input import VOLTAGE, Input
from arm_emulator.machine.parts.joint_effects.joint_effect import JointEffect
from arm_emulator.machine.parts.measuring.encoder import Encoder
from arm_emulator.machine.parts.measuring.sensors import JointSensors
from arm_emulator.machine.parts.motors.motor import Motor, ServoData
from arm_emulator.machine.parts.part import Part
from arm_emulator.machine.scene.known_parts import (
    LINK_FRICTIONS,
    ROTOR_FRICTIONS,
    find_gear,
    link_friction_of,
    read_bearing,
    read_decorators,
    read_extras,
    read_friction,
    read_gear,
    read_gear_stages,
    read_motor,
)

Kind = TypeVar("Kind", bound=Part)


@dataclass(frozen=True, kw_only=True)
class Joint:
    """Section of one moving joint in a scene. A joint without a motor swings freely."""

    name: str
    start: float = number(
        "rad or m",
        ends=(-1e4, 1e4),
        default=0.0,
        text="position after a reset; the motor stands along with it, the gear carries no torque",
    )
    motor: Motor | None
    gear: Gear
    gear_stages: tuple[GearStage, ...] = ()  # within its gear
    sensors: JointSensors
    friction: Friction
    rotor_friction: OfRotor | None = None
    decorators: tuple[DriveStage, ...] = ()  # around its motor, innermost first
    brake: Brake | None = None
    extras: tuple[JointEffect, ...] = ()  # that stand in sections of their own
    bearing: tuple[Deflection, ...] = ()  # directions in which it gives way

    @property
    def parts(self) -> tuple[Part, ...]:
        """All parts of its drive."""
        motor = () if self.motor is None else (self.motor,)
        rotor = () if self.rotor_friction is None else (self.rotor_friction,)
        brake = () if self.brake is None else (self.brake,)
        of_motor = (*motor, *self.decorators)
        return (
            *of_motor,
            self.gear,
            *self.gear_stages,
            self.friction,
            *rotor,
            *brake,
            *self.extras,
            *self.bearing,
        )

    def find_part(self, kind: type[Kind]) -> Kind | None:
        """Return its part of a kind, None if it has none."""
        return next((part for part in self.parts if isinstance(part, kind)), None)

    def list_drives(self) -> dict[str, Joint]:
        """Return its drive and those of its bearing's deflections, as joints without motors."""
        rigid, friction = find_gear(ratio=1.0), link_friction_of()
        return {self.name: replace(self, bearing=())} | {
            name_deflection(self.name, type(spring)): Joint(
                name=self.name,
                motor=None,
                gear=rigid,
                sensors=JointSensors(),
                friction=friction,
                bearing=(spring,),
            )
            for spring in self.bearing
        }

    @property
    def inputs(self) -> tuple[Input, ...]:
        """Inputs of its motor: the command first, then further ones."""
        of_motor = self.motor.inputs if self.motor else (VOLTAGE,)
        return next(
            (decorator.inputs for decorator in self.decorators[::-1] if decorator.inputs), of_motor
        )

    @property
    def stops(self) -> tuple[float, float] | None:
        """Positions between which stops keep its link [rad or m]; None: there are no stops."""
        return next((effect.stops for effect in self.extras if effect.stops), None)

    @property
    def unit(self) -> str:
        """Unit of its command: V, N m or A."""
        return self.inputs[0].unit

    @property
    def current_bandwidth(self) -> float:
        """Bandwidth of its drive's current loop [Hz]; 0: it has none."""
        if self.motor is None:
            return 0.0
        return max(
            (decorator.compute_bandwidth(self.motor) for decorator in self.decorators), default=0.0
        )

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

    def compute_largest_command(self, supply_voltage: float) -> float | None:
        """Return its drive's largest command in either direction; None: unlimited.

        Args:
            supply_voltage: of the scene [V].
        """
        largest = 0.0 if self.motor is None else self.motor.compute_largest_command(supply_voltage)
        return None if largest is None else largest / self._of_motor_per_command

    @property
    def _of_motor_per_command(self) -> float:
        """Command of the motor itself at rest, per unit of the joint's command."""
        if self.motor is None:
            return 1.0
        return math.prod(
            decorator.convert_unit_command(self.motor) for decorator in self.decorators
        )

    @property
    def encoder(self) -> Encoder | None:
        """Encoder of its motor, or None."""
        return self.sensors.encoder

    @property
    def counts_per_turn(self) -> int:
        """Counts of the encoder in a turn of the motor; without one, of the finest there is."""
        return self.sensors.counting.counts_per_turn


def read_joints(
    root: Section, chain: Chain, urdf_name: str, limits: Mapping[str, tuple[float, float]]
) -> tuple[Joint, ...]:
    """Read the section of every moving joint, base to tool.

    Args:
        root: the scene.
        chain: its links.
        urdf_name: their file.
        limits: of joints, by name [rad or m].

    Raises:
        Refusal: a joint is missing, does not move, or breaks a rule.
    """
    section = root.require_section("joints")
    names = {joint.name: joint.kind for joint in chain.joints}
    for key in section.list_keys():
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
        joint_section = section.get_section(name)
        if joint_section is None:
            raise Refusal(
                root.where,
                f"joints.{name}",
                f"be given, {urdf_name} moves it",
                "nothing",
                "a section, or its position under `locked`",
            )
        joints.append(read_joint(name, kind, joint_section, limits.get(name)))
    return tuple(joints)


def read_joint(name: str, kind: str, section: Section, limits: tuple[float, float] | None) -> Joint:
    """Read the section of a joint.

    Args:
        name: of the joint.
        kind: revolute or prismatic.
        section: its section.
        limits: in the description [rad or m]; None: it has none.

    Raises:
        Refusal: it breaks a rule.
    """
    motor, gear, friction = (
        section.get_section("motor"),
        section.get_section("gear"),
        section.get_section("friction"),
    )
    of_rotor = None if motor is None else motor.get_section("friction")
    brake = section.get_section(Brake.section)
    for key, part in ((Gear.section, gear), (Brake.section, brake)):
        if motor is None and part is not None:
            raise section.make_refusal(key, "belong to a joint with a motor", "no motor section")
    driven = None if motor is None else read_motor(motor)
    joint = Joint(
        name=name,
        **section.read_numbers(Joint),
        motor=driven,
        gear=find_gear(ratio=1.0) if gear is None else read_gear(gear),
        gear_stages=read_gear_stages(section),
        sensors=JointSensors.read_section(section, kind),
        friction=link_friction_of()
        if friction is None
        else read_friction(friction, LINK_FRICTIONS),
        rotor_friction=None if of_rotor is None else read_friction(of_rotor, ROTOR_FRICTIONS),
        decorators=read_decorators(driven, motor) if driven and motor else (),
        brake=None if brake is None else Brake.read_section(brake),
        extras=read_extras(section, limits),
        bearing=read_bearing(section),
    )
    section.refuse_unread_keys()
    for extra in joint.extras:
        extra.check_parts(joint.parts, section)
    for stage in joint.gear_stages:
        stage.check_gear(joint.gear, section)
    for law in (joint.friction, joint.rotor_friction):
        if law is not None:
            law.check_gear(joint.gear if driven else None, section)
    if joint.motor is not None:
        for decorator in joint.decorators:
            decorator.check_motor(joint.motor, section)
        _check_reflected(joint.motor, joint.gear.ratio, section)
    return joint


def _check_reflected(motor: Motor, ratio: float, section: Section) -> None:
    """Refuse a gear whose ratio makes numbers at the link too large or too small."""
    for quantity, value in motor.reflect_to_link(ratio).items():
        if value > LARGEST:
            rule = f"make the {quantity} at the link at most {LARGEST:g}"
            raise section.make_refusal("gear.ratio", rule, f"{value:.3g} with {ratio:g}")
