"""Torque sensors at the output of gears."""

from __future__ import annotations

from dataclasses import dataclass

from emulator_node.parts.analog_sensor import AnalogSensor


@dataclass(frozen=True, kw_only=True)
class TorqueSensor(AnalogSensor):
    """Of the torque that a joint's gear puts on its link."""

    section = "torque_sensor"
    unit = "N m"
