"""Tachometers on the shafts of motors."""

from arm_emulator.machine.parts.measuring.analog_sensor import AnalogSensor
from arm_emulator.machine.parts.output import READINGS, Output
from arm_emulator.machine.parts.registry import register_part


@register_part
class MotorTachometer(AnalogSensor):
    """Sensor of the speed of a motor's shaft."""

    section = "motor_tachometer"
    shaft = "rotor"
    unit = "rad/s"
    reads = "now.motor_speed"
    outputs = (
        Output("motor_speed", "speed of each motor, by the tachometer on its shaft", READINGS,
               "rad/s"),
    )  # fmt: skip
