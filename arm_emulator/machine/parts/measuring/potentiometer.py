"""Potentiometers at links."""

from arm_emulator.machine.parts.measuring.analog_sensor import AnalogSensor
from arm_emulator.machine.parts.output import READINGS, Output
from arm_emulator.machine.parts.registry import register_part


@register_part
class Potentiometer(AnalogSensor):
    """Sensor of the position of a joint's link."""

    section = "potentiometer"
    unit = "rad"
    reads = "now.machine.state().q"
    of = ""
    outputs = (
        Output("link_position", "position of each link, by its potentiometer", READINGS,
               "rad", "m"),
    )  # fmt: skip
