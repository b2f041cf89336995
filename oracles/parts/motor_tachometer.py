"""Tachometers on the shafts of motors, apart from their declaration."""

from arm_emulator import Plant
from arm_emulator.base.arrays import Array
from oracles.parts import analog_sensor

NUMBERS = "[joints.NAME.motor_tachometer, U = rad/s]" + analog_sensor.NUMBERS_OF_SENSORS
FAULTS = "[of joints, S = motor_tachometer, U = rad/s]" + analog_sensor.FAULTS_OF_SENSORS
OUTPUTS = {"motor_speed": ("rad/s", "rad/s")}
EXCEEDED = 120.0  # by the quantity in a motion of `test/sensors/test_readings.py`


def measure(plant: Plant) -> Array:
    """Return the true quantity of each joint."""
    return plant.state.omega_m
