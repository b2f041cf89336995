"""Scenes without what no other simulator of this report has.

Brakes, end stops, current loops, friction that sticks, gears that are more than a spring and a
damper, and steps that are cut at events.
"""

from __future__ import annotations

from arm_emulator.machine.parts.frictions.brake import Brake
from arm_emulator.machine.parts.frictions.friction import LinkFriction
from arm_emulator.machine.parts.gears.elastic_gear import ElasticGear
from arm_emulator.machine.parts.gears.gear import RigidGear
from arm_emulator.machine.parts.motors.dc_motor import DcMotor
from arm_emulator.machine.scene.known_parts import (
    DECORATORS,
    EXTRAS,
    GEARS,
    LINK_FRICTIONS,
    ROTOR_FRICTIONS,
    remove_kind,
)
from arm_emulator.machine.scene.scene import Scene

# The parts that a bare scene has.
PLAIN = (DcMotor, ElasticGear, RigidGear, LinkFriction)

DRY = ("coulomb", "breakaway")
_PLAIN_KEYS = {key for kind in PLAIN for key in kind.list_numbers()} - {*DRY}

BARE = {
    **remove_kind((Brake, *EXTRAS, *DECORATORS, *ROTOR_FRICTIONS)),
    **{
        f"joints.*.{kind.section}.{key}": None
        for kind in (*GEARS, *LINK_FRICTIONS)
        for key in kind.list_numbers()
        if key not in _PLAIN_KEYS
    },
    "joints.*.motor.current_limit": None,
    "integrator.events": "step",
}


def list_odd_parts(scene: Scene) -> list[str]:
    """Return what a scene has beside the parts of a bare one, by joint and section."""
    return [
        f"joints.{joint.name}.{part.section}"
        for joint in scene.joints
        for part in joint.parts
        if type(part) not in PLAIN or (isinstance(part, LinkFriction) and part.can_stick)
    ]
