"""Faults of sensors with an amplifier and a converter."""

from __future__ import annotations

from arm_emulator.base.number import Number
from arm_emulator.machine.faults.fault import FALLS, HOLDS, RISES, STUCK, Fault, rise, share
from arm_emulator.machine.parts.analog_sensor import LARGEST_ERROR
from arm_emulator.machine.parts.imu import Accelerometer, Gyroscope
from arm_emulator.machine.parts.part import Part
from arm_emulator.machine.parts.sensors import ANALOG


def _kinds(sensor: type[Part], offset: str) -> tuple[Fault, ...]:
    section, unit = sensor.section, sensor.numbers()["noise"].unit

    def kind(
        name: str,
        text: str,
        key: str,
        magnitude: Number,
        expression: str = RISES,
        absent: float | None = None,
    ) -> Fault:
        return Fault(
            name=f"{section}_{name}",
            of=sensor.owners,
            text=f"{section.replace('_', ' ')}: {text}",
            sets={f"{section}.{key}": expression},
            magnitude=magnitude,
            absent=absent,
        )

    return (
        kind("offset", "the amplifier's zero moves", offset,
             rise(unit, 0.5, LARGEST_ERROR, signed=True), absent=0.0),
        kind("drifts", "the amplifier's zero drifts", "drift",
             rise(f"{unit}/s", 0.5, LARGEST_ERROR, signed=True), absent=0.0),
        kind("gain", "the amplifier's gain is off", "gain_error",
             rise("1", 0.1, 1.0, signed=True), absent=0.0),
        kind("stuck", STUCK, "held", share(), HOLDS, absent=0.0),
        kind("noisy", "the shield is broken", "noise", rise(unit, 0.1, LARGEST_ERROR), absent=0.0),
        kind("saturates", "the amplifier's range falls", "range", share(0.9, 0.999), FALLS),
    )  # fmt: skip


FAULTS = tuple(
    fault
    for sensors, offset in ((ANALOG, "offset"), ((Accelerometer, Gyroscope), "bias_x"))
    for sensor in sensors
    for fault in _kinds(sensor, offset)
)
