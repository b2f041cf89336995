"""Potentiometers at links, apart from their declaration."""

from arm_emulator import Plant
from arm_emulator.base.arrays import Array
from oracles.parts import analog_sensor

NUMBERS = "[joints.NAME.potentiometer, U = rad]" + analog_sensor.NUMBERS_OF_SENSORS
FAULTS = "[of joints, S = potentiometer, U = rad]" + analog_sensor.FAULTS_OF_SENSORS
OUTPUTS = {"link_position": ("rad", "m")}
EXCEEDED = 0.4  # by the quantity in a motion of `test/sensors/test_readings.py`


def measure(plant: Plant) -> Array:
    """Return the true quantity of each joint."""
    return plant.state.q
