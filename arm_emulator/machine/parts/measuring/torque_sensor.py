"""Torque sensors at the output of gears."""

from arm_emulator.machine.parts.measuring.analog_sensor import AnalogSensor
from arm_emulator.machine.parts.output import Output
from arm_emulator.machine.parts.registry import register_part


@register_part
class TorqueSensor(AnalogSensor):
    """Sensor of the torque of a joint's gear on its link."""

    section = "torque_sensor"
    unit = "N m"
    reads = "now.gear_torques()"
    field = "torque"
    channel = 3
    outputs = (
        Output("torque", "torque of each gear on its link, by its sensor", "sensors.torque",
               "N m", "N"),
    )  # fmt: skip
