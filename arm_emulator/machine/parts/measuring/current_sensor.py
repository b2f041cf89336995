"""Sensors of motor currents."""

from arm_emulator.machine.parts.measuring.analog_sensor import AnalogSensor
from arm_emulator.machine.parts.registry import register_part


@register_part
class CurrentSensor(AnalogSensor):
    """Sensor of the current of a joint's motor."""

    section = "current_sensor"
    unit = "A"
    reads = "now.current"
    field = "current"
    channel = 2
