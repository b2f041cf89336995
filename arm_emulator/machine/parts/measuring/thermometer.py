"""Thermometers in the windings of motors."""

from arm_emulator.machine.parts.measuring.analog_sensor import AnalogSensor
from arm_emulator.machine.parts.output import READINGS, Output
from arm_emulator.machine.parts.registry import register_part


@register_part
class Thermometer(AnalogSensor):
    """Sensor of the temperature of a joint's winding."""

    section = "thermometer"
    unit = "degC"
    of = "motor.winding"
    reads = "now.winding_temperatures()"
    outputs = (
        Output("motor_temperature", "temperature of each winding, by its thermometer", READINGS,
               "degC"),
    )  # fmt: skip
