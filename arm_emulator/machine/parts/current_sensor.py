"""Sensors of motor currents."""

from __future__ import annotations

from arm_emulator.machine.parts.analog_sensor import AnalogSensor
from arm_emulator.machine.parts.registry import register_part
from arm_emulator.machine.parts.resting import AtRest, Share


@register_part
class CurrentSensor(AnalogSensor):
    """Of the current of a joint's motor."""

    section = "current_sensor"
    unit = "A"
    reads = "now.current"
    field = "current"
    channel = 2

    def rests(self, at: AtRest) -> Share | str:
        """The servo's integral takes up a constant error."""
        return Share(current_noise=self.noise or 0.0)
