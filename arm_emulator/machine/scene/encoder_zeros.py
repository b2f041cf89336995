"""Reports of encoders whose joints are at 0, from the calibration of a machine."""

from dataclasses import replace
from typing import TypeVar

from arm_emulator.base.calibration.calibration import Calibration, name_key
from arm_emulator.base.refusal import Refusal
from arm_emulator.machine.parts.measuring.encoder import Encoder
from arm_emulator.machine.scene.joint import Joint

AnyEncoder = TypeVar("AnyEncoder", bound=Encoder)


def put_zeros(joints: tuple[Joint, ...], calibration: Calibration) -> tuple[Joint, ...]:
    """Return joints whose encoders are turned on their shafts as a calibration has it.

    Raises:
        Refusal: a joint has no encoder of its own.
    """
    zeros = {
        name: deviation.encoder_zero
        for name, deviation in calibration.deviations.items()
        if deviation.encoder_zero
    }
    driven = {joint.name for joint in joints if joint.motor is not None}
    for name in zeros:
        if name not in driven:
            names = ", ".join(sorted(driven)) or "none"
            rule = "belong to a joint with a motor"
            raise Refusal(calibration.where, name_key(name, "encoder_zero"), rule, name, names)
    return tuple(
        _turn_discs(joint, zeros[joint.name]) if joint.name in zeros else joint for joint in joints
    )


def _turn_discs(joint: Joint, zero: float) -> Joint:
    """Return a joint whose encoders report `zero` [rad or m] more than its position."""
    sensors = joint.sensors
    at_link = sensors.link_encoder
    return replace(
        joint,
        sensors=replace(
            sensors,
            encoder=_turn_encoder(sensors.counting, zero / joint.gear.ratio),
            link_encoder=None if at_link is None else _turn_encoder(at_link, zero),
        ),
    )


def _turn_encoder(encoder: AnyEncoder, angle: float) -> AnyEncoder:
    return replace(encoder, offset=(encoder.offset or 0.0) + angle)
