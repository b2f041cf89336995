"""Tachometers at links."""

from arm_emulator.machine.parts.measuring.analog_sensor import AnalogSensor
from arm_emulator.machine.parts.output import READINGS, Output
from arm_emulator.machine.parts.registry import register_part


@register_part
class Tachometer(AnalogSensor):
    """Sensor of the speed of a joint's link."""

    section = "tachometer"
    unit = "rad/s"
    reads = "now.machine.state().v"
    of = ""
    outputs = (
        Output("link_speed", "speed of each link, by its tachometer", READINGS, "rad/s", "m/s"),
    )
