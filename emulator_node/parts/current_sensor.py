"""Sensors of motor currents."""

from __future__ import annotations

from dataclasses import dataclass

from emulator_node.parts.analog_sensor import AnalogSensor


@dataclass(frozen=True, kw_only=True)
class CurrentSensor(AnalogSensor):
    """Of the current of a joint's motor."""

    section = "current_sensor"
    unit = "A"
