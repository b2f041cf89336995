"""Thermometers in windings, apart from their declaration."""

from arm_emulator import Plant
from arm_emulator.base.arrays import Array
from oracles.parts import analog_sensor

NUMBERS = "[joints.NAME.thermometer, U = degC]" + analog_sensor.NUMBERS_OF_SENSORS
FAULTS = "[of joints, S = thermometer, U = degC]" + analog_sensor.FAULTS_OF_SENSORS
OUTPUTS = {"motor_temperature": ("degC", "degC")}
EXCEEDED = 100.0  # by the quantity in a motion of `test/sensors/test_readings.py`


def measure(plant: Plant) -> Array:
    """Return the true quantity of each joint."""
    return plant.winding_temperatures
